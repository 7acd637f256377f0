"""What a video shows on the surface of a vehicle, point by point: no warp, no optical flow, no weights."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree

from dwgs.scene import Camera, Insertion
from dwgs.scene.pose import transform_points
from dwgs.scene.silhouette import NEAR

WATCHED = 4000
"""Points of a vehicle that are followed through the video."""
CASTERS = 40_000
"""Points that hide what is behind them."""
CELL = 2.5
"""Points are hidden cell by cell, so many spacings wide: random points leave no such cell empty."""
BEHIND = 0.2
"""A point this much behind the front of its cell [m] lies on another side, where no normal says more."""
LAYER = 0.03
"""A surface this much behind another [m] is hidden, once its slope is allowed for."""
FACING = 0.25
"""A point whose normal is turned further away than this cosine is on the rim, where pixels mix it with the street."""
FEWEST = 20
"""A frame that shows fewer of the watched points says nothing."""


def skin_colors(
    insertion: Insertion, cameras: Sequence[Camera], pixels: Callable[[int], NDArray[np.uint8]]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Colours [T, P, 3] that T frames show at P points of the vehicle, NaN where hidden; and the points' own [P, 3].

    All in levels of [0, 255]. ``pixels(t)`` is the image [H, W, 3] that ``cameras[t]`` took.
    """
    vehicle = insertion.vehicle
    watched = np.unique(np.linspace(0, len(vehicle.points) - 1, WATCHED).round().astype(int))
    casters = vehicle.points[:: 1 + len(vehicle.points) // CASTERS]
    sample = casters[:: 1 + len(casters) // 2000]
    spacing = float(np.median(KDTree(casters).query(sample, k=min(5, len(casters)))[0].reshape(len(sample), -1)[:, -1]))
    normals = vehicle.normals[watched] if vehicle.normals is not None and vehicle.is_complete else None
    points = vehicle.points[watched]
    colors = np.full((len(cameras), len(points), 3), np.nan, np.float32)
    for t, camera in enumerate(cameras):
        camera_from_vehicle = camera.camera_from_world @ insertion.trajectory.at(camera.time)
        seen, uv = _seen(camera, camera_from_vehicle, points, normals, casters, spacing)
        if not seen.any():
            continue
        image, at = pixels(t).astype(np.float32), uv[seen, ::-1].T - 0.5
        colors[t, seen] = np.stack([map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(3)], -1)
    return colors, vehicle.colors[watched].astype(np.float32)


def point_error(colors: NDArray, own: NDArray) -> float:
    """How badly shown colours [T, P, 3] tell the points' ``own`` [P, 3]: RMS error [levels]; NaN where none is seen.

    In each frame and channel the own colours are predicted from the shown ones by the best line, which allows for
    light and haze. Colours in the wrong place predict nothing, and neither does a vehicle of one colour: the error is
    then the spread of the own colours.
    """
    errors = []
    for frame in colors:
        seen = np.isfinite(frame[:, 0])
        if seen.sum() >= FEWEST:
            shown, given = (c[seen] - c[seen].mean(0, dtype=np.float64) for c in (frame, own))
            slope = (shown * given).sum(0) / np.maximum((shown**2).sum(0), 1e-9)
            errors.append(((given - slope * shown) ** 2).mean())
    return float(np.sqrt(np.mean(errors))) if errors else np.nan


def flicker(colors: NDArray) -> float:
    """Mean departure [levels] of a point's colour from the mean of the frames before and after; NaN where none.

    Of colours [T, P, 3] on the vehicle. What changes steadily, as light does, is no flicker.
    """
    departures = np.abs(colors[1:-1] - (colors[:-2] + colors[2:]) / 2)
    seen = np.isfinite(departures)
    return float(departures[seen].mean(dtype=np.float64)) if seen.sum() >= FEWEST else np.nan


def _seen(
    camera: Camera,
    camera_from_vehicle: NDArray,
    points: NDArray,
    normals: NDArray | None,
    casters: NDArray,
    spacing: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which points [P] a camera sees of the vehicle, whatever else stands before it, and their pixels [P, 2]."""
    local = transform_points(camera_from_vehicle, points)
    uv, depth = _project(camera, local)
    seen = (depth > NEAR) & (uv > 0.5).all(1) & (uv < (camera.width - 0.5, camera.height - 0.5)).all(1)
    facing = np.full(len(points), np.nan)
    if normals is not None:
        facing = -(normals @ camera_from_vehicle[:3, :3].T * local).sum(1) / np.linalg.norm(local, axis=1)
        seen &= facing > FACING
    if not seen.any():
        return seen, uv
    cell = max(1.0, CELL * spacing * camera.K[0, 0] / float(depth[seen].min()))
    columns, rows = int(camera.width / cell) + 1, int(camera.height / cell) + 1
    front = np.full(rows * columns, np.inf)
    cast_uv, cast_depth = _project(camera, transform_points(camera_from_vehicle, casters))
    drawn = (cast_depth > NEAR) & camera.contains(cast_uv)
    column, row = (cast_uv[drawn] / cell).astype(int).T
    np.minimum.at(front, row * columns + column, cast_depth[drawn])
    column, row = (uv[seen] / cell).astype(int).T
    slope = np.sqrt(1 - np.clip(facing[seen], 0, 1) ** 2) / facing[seen]
    behind = np.where(np.isnan(slope), BEHIND, LAYER + 1.5 * slope * cell * depth[seen] / camera.K[0, 0])
    seen[seen] = depth[seen] <= front[row * columns + column] + behind
    return seen, uv


def _project(camera: Camera, local: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels [P, 2] and depths [P] of points [P, 3] in the camera's frame."""
    depth = local[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (local @ camera.K.T)[:, :2] / depth[:, None], depth
