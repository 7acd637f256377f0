"""What the LiDAR says about how far the pixels of an image are."""

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.scene import Camera

NEAREST = 0.5
"""Nothing is seen nearer to a camera than this [m]."""
OCCLUSION_CELL = 4
"""Hits are compared within cells of so many pixels: the LiDAR looks over what hides a hit from the camera."""
OCCLUSION_RATIO = 1.15
"""A hit this many times farther than the nearest one of its cell is taken for hidden."""


def pixels_of(
    points: NDArray[np.floating], camera: Camera
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Which of the world ``points`` [P, 3] the image holds: indices, rows, columns, depths [m], each [I]."""
    K_from_world = torch.from_numpy((camera.K @ camera.camera_from_world[:3]).astype(np.float32))
    p = torch.from_numpy(points).float() @ K_from_world[:, :3].T + K_from_world[:, 3]
    x, y, depth = p.unbind(1)
    inside = (depth > NEAREST) & (x >= 0) & (x < camera.width * depth) & (y >= 0) & (y < camera.height * depth)
    index = inside.nonzero()[:, 0]
    x, y, depth = p[index].unbind(1)
    columns = (x / depth).long().clamp(0, camera.width - 1)
    rows = (y / depth).long().clamp(0, camera.height - 1)
    return index.numpy(), rows.numpy(), columns.numpy(), depth.numpy()


def depth_samples(points: NDArray[np.float32], camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Pixels [S, 2] (row, column) with the depths [S] [m] that world ``points`` [P, 3] give them.

    One sample for a pixel, the nearest; none where a neighbour is much nearer.
    """
    _, rows, columns, depths = pixels_of(points, camera)
    order = np.argsort(depths, kind="stable")
    _, first = np.unique(rows[order] * camera.width + columns[order], return_index=True)
    nearest = order[first]
    rows, columns, depths = rows[nearest], columns[nearest], depths[nearest]
    floor = np.full((camera.height // OCCLUSION_CELL + 1, camera.width // OCCLUSION_CELL + 1), np.inf, np.float32)
    cell = rows // OCCLUSION_CELL, columns // OCCLUSION_CELL
    np.minimum.at(floor, cell, depths)
    visible = depths < OCCLUSION_RATIO * floor[cell]
    return np.stack([rows, columns], 1)[visible], depths[visible]
