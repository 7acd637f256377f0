"""What lies beyond the LiDAR: a smooth sky, and a far shell of Gaussians for all that has a shape there."""

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.reconstruct.discs import blobs
from dwgs.reconstruct.inpaint import fill_smoothly
from dwgs.scene import Gaussians
from dwgs.scene.background import sky_coordinates

SKY_SHAPE = (512, 1024)
"""Rows and columns of the sky image: about 5 px of a street camera each."""
HORIZON = 0.02
"""Part of the sky image below the horizon over which sky turns into road."""
SHELL_RADIUS = 2000.0
"""Where the shell stands [m]: towers a kilometre away must not slide against it while the car drives on."""
SHELL_PIXELS = 2.0
"""Distance between Gaussians of the shell [px]."""
SHELL_CONTRAST = 0.03
"""The shell stays empty where the sky alone shows the pixel to within this."""
SHELL_OPACITY = 0.8


def paint_sky(
    directions: NDArray[np.float64], colors: NDArray[np.float64], nadir: NDArray[np.float64]
) -> NDArray[np.float32]:
    """An equirectangular sky (see `Background.sky`) from ``colors`` [N, 3] seen along ``directions`` [N, 3].

    Directions never seen continue the seen ones smoothly. Below the horizon lies ``nadir`` [3], the colour of
    the road: should a ray ever slip through the ground, it must not find sky.
    """
    height, width = SKY_SHAPE
    road = np.broadcast_to(nadir, (height, width, 3))
    if len(directions) == 0:
        return road.astype(np.float32)
    row, column = (sky_coordinates(directions) * SKY_SHAPE[::-1]).astype(int).T[::-1]
    cell = np.minimum(row, height - 1) * width + np.minimum(column, width - 1)
    counts = np.bincount(cell, minlength=height * width).reshape(height, width)
    sums = [np.bincount(cell, channel, minlength=height * width) for channel in colors.T]
    image = np.stack(sums, -1).reshape(height, width, 3) / np.maximum(counts, 1)[..., None]
    # The image is a cylinder: fill a copy that begins half a turn earlier and ends half a turn later.
    half = width // 2
    image, known = (np.concatenate([x[:, half:], x, x[:, :half]], 1) for x in (image, counts > 0))
    sky = fill_smoothly(torch.from_numpy(image).float(), torch.from_numpy(known).float()).numpy()
    below = np.clip((np.arange(height) / height - 0.5) / HORIZON, 0, 1)[:, None, None]
    return ((1 - below) * sky[:, half : half + width] + below * road).clip(0, 1).astype(np.float32)


def far_shell(
    centre: NDArray[np.float64], directions: NDArray[np.float64], colors: NDArray[np.float64], focal: float
) -> Gaussians:
    """Gaussians at `SHELL_RADIUS` around ``centre`` [3], `SHELL_PIXELS` apart for a camera of ``focal`` [px].

    The first of the ``directions`` [N, 3] with ``colors`` [N, 3] that fall onto one place decides its colour.
    """
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    spacing = SHELL_PIXELS / focal
    cells = np.round(directions / spacing).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    first = np.sort(first)
    radii = np.full(len(first), 0.5 * spacing * SHELL_RADIUS)
    return blobs(centre + SHELL_RADIUS * directions[first], radii, colors[first], SHELL_OPACITY)
