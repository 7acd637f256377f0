"""As many points as the images can tell apart."""

import numpy as np
from numpy.typing import NDArray

from dwgs.reconstruct.depth_samples import pixels_of
from dwgs.scene import Camera

VOXEL_PIXELS = 3.0
"""Points nearer to each other than this, from where they are seen best, become one."""


def spacing_in_view(points: NDArray[np.float32], cameras: list[Camera]) -> NDArray[np.float32]:
    """The size [N] [m] of `VOXEL_PIXELS` at each point's nearest view; infinite where no camera sees it."""
    best = np.full(len(points), np.inf, np.float32)
    for camera in cameras:
        index, _, _, depths = pixels_of(points, camera)
        best[index] = np.minimum(best[index], depths * np.float32(VOXEL_PIXELS / camera.K[0, 0]))
    return best


def thin(points: NDArray[np.floating], sizes: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The mean point of every voxel [M, 3], and its size [M] [m]: that of ``sizes`` [N], in half octaves."""
    levels = np.round(2 * np.log2(sizes)).astype(np.int64)
    voxel_sizes = 2.0 ** (levels / 2)
    cells = np.floor(points / voxel_sizes[:, None]).astype(np.int64)
    cells -= cells.min(0, initial=0)
    key = levels - levels.min(initial=0)
    for axis in range(3):
        key = key * (cells[:, axis].max(initial=0) + 1) + cells[:, axis]
    _, first, voxel, counts = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxel, points[:, axis], minlength=len(counts)) for axis in range(3)]
    return np.stack(sums, 1) / counts[:, None], voxel_sizes[first]
