"""The outline of a box in an image."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.camera import Camera
from dwgs.scene.insertion import box_corners
from dwgs.scene.pose import transform_points

NEAR = 0.1
"""Nothing nearer to the camera than this depth [m] is drawn; a box that reaches behind it is cut there."""

_FIRST, _SECOND = np.triu_indices(8, k=1)


def box_silhouette(
    camera: Camera, world_from_box: NDArray[np.float64], size: NDArray, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Pixels [H, W] whose centres see the box, or pass it within ``margin`` [px].

    Args:
        camera: Where it is seen from.
        world_from_box: [4, 4] pose of the box centre.
        size: [3] (length, width, height) [m].
        margin: How far the outline is moved outwards [px].
    """
    corners = transform_points(camera.camera_from_world @ world_from_box, box_corners(size))
    visible = _cut_at_near_plane(corners) @ camera.K.T
    return fill_convex_hull(visible[:, :2] / visible[:, 2:], camera.width, camera.height, margin)


def fill_convex_hull(points: NDArray[np.float64], width: int, height: int, margin: float = 0.0) -> NDArray[np.bool_]:
    """Pixels [H, W] whose centres lie in the hull of ``points`` [P, 2] [px], moved outwards by ``margin``."""
    mask = np.zeros((height, width), bool)
    if len(points) == 0:
        return mask
    low = np.clip(np.floor(points.min(0) - margin), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(points.max(0) + margin), 0, (width, height)).astype(int)
    x = np.arange(low[0], high[0]) + 0.5
    y = np.arange(low[1], high[1])[:, None] + 0.5
    inside = np.ones((len(y), len(x)), bool)
    if inside.size == 0:
        return mask
    hull = _convex_hull(points)
    for a, b in zip(hull, np.roll(hull, -1, axis=0), strict=True):
        edge = b - a
        length = np.hypot(*edge)
        if length > 0:
            inside &= edge[0] * (y - a[1]) - edge[1] * (x - a[0]) >= -margin * length
    mask[low[1] : high[1], low[0] : high[0]] = inside
    return mask


def _cut_at_near_plane(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points [P, 3] before the near plane whose hull is the part of the box [8, 3] that lies there."""
    a, b = corners[_FIRST], corners[_SECOND]
    crosses = (a[:, 2] < NEAR) != (b[:, 2] < NEAR)
    a, b = a[crosses], b[crosses]
    s = (NEAR - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    return np.concatenate([corners[corners[:, 2] >= NEAR], a + s * (b - a)])


def _convex_hull(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners [C, 2] of the hull of ``points`` [P, 2], ordered so that ``cross(edge, inside - start)`` is
    positive (Andrew's monotone chain)."""
    points = np.unique(points, axis=0)

    def chain(ordered: list[list[float]]) -> list[list[float]]:
        kept: list[list[float]] = []
        for x, y in ordered:
            while len(kept) > 1:
                (x0, y0), (x1, y1) = kept[-2:]
                if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                    break
                kept.pop()
            kept.append([x, y])
        return kept

    if len(points) < 3:
        return points
    ordered = points.tolist()
    return np.array(chain(ordered)[:-1] + chain(ordered[::-1])[:-1])
