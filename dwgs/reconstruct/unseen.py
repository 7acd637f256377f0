"""The road where nothing was ever measured: under traffic, in the shadow of the LiDAR, beyond its reach."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.scene import Camera
from dwgs.scene.ground import Ground
from dwgs.scene.sky import pixel_rays

REACH = 150.0
"""Rays that meet the ground farther away than this [m] show the distance, not the road."""
ROUNDS = 6
"""Of the fixed-point iteration that finds where a ray meets the ground."""
TOLERANCE = 0.2
"""How well it is found [m]; rays that graze a rise do worse and are given up."""
COLUMN_STRIDE, SUBROWS = 2, 4
"""Pixels between rays across, and rays per pixel down: the road is seen at a grazing angle."""
NEIGHBOURS = 48
"""Known pieces of road that tell the colour of an unknown one."""


def meet_ground(
    ground: Ground, origin: NDArray[np.float64], rays: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where ``rays`` [R, 3] (one metre deep each) from ``origin`` [3] first come down to the ground.

    Returns:
        Points [R, 3] [m], and which of the rays [R] arrive within `REACH`; the points of others mean nothing.
    """
    points, depth = np.broadcast_to(origin, rays.shape), np.zeros(len(rays))
    for _ in range(ROUNDS):
        height = ground.height(points[:, :2])
        depth = np.clip((height - origin[2]) / np.minimum(rays[:, 2], -1e-6), 0, 2 * REACH)
        points = origin + depth[:, None] * rays
    settled = np.abs(points[:, 2] - ground.height(points[:, :2])) < TOLERANCE
    return points, (rays[:, 2] < 0) & (depth > 0) & (depth < REACH) & settled


def road_seen(
    ground: Ground, camera: Camera, mask: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ground [R, 3] that the pixels of ``mask`` [H, W] look at, and how far apart its points may lie [R] [m].

    A pixel far away is a long thin strip of road. Points may be as far apart as the side of a square of the
    same area, and rows are subdivided to be that dense.
    """
    fine = camera.resize(camera.width // COLUMN_STRIDE, camera.height * SUBROWS)
    rays = pixel_rays(fine)[mask.repeat(SUBROWS, 0)[:, : fine.width * COLUMN_STRIDE : COLUMN_STRIDE]]
    points, arrives = meet_ground(ground, camera.position, rays)
    points, rays = points[arrives], rays[arrives]
    depth = (points - camera.position) @ camera.world_from_camera[:3, 2]
    across = depth / camera.K[0, 0]
    steepness = np.maximum(-rays[:, 2], 1e-3) / np.linalg.norm(rays, axis=1)
    return points, COLUMN_STRIDE * across / np.sqrt(steepness)


def continue_colors(
    points: NDArray[np.float64],
    colors: NDArray[np.float64],
    known: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """The colours [N, 3] with those ``wanted`` [N] replaced by a smooth continuation of those ``known`` [N].

    Inverse square distance over the nearest known points on the map: the road goes on under what stood on it.
    """
    if not known.any() or not wanted.any():
        return colors
    tree = KDTree(points[known, :2])
    distances, index = tree.query(points[wanted, :2], k=min(NEIGHBOURS, int(known.sum())), workers=-1)
    distances, index = distances.reshape(wanted.sum(), -1), index.reshape(wanted.sum(), -1)
    weights = 1 / np.maximum(distances, 0.05) ** 2
    weights /= weights.sum(1, keepdims=True)
    continued = colors.copy()
    continued[wanted] = (weights[..., None] * colors[known][index]).sum(1)
    return continued
