"""What a camera sees of an equirectangular sky."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.background import sky_coordinates
from dwgs.scene.camera import Camera


def pixel_rays(camera: Camera) -> NDArray[np.float64]:
    """World directions [H, W, 3] through the pixel centres, one metre deep along the optical axis."""
    x = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    y = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    x, y = np.meshgrid(x, y)
    x = x - camera.K[0, 1] / camera.K[0, 0] * y
    return np.stack([x, y, np.ones_like(x)], -1) @ camera.world_from_camera[:3, :3].T


def sky_image(sky: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Colours [H, W, 3] that a camera sees of a sky [h, w, 3] (see `Background.sky`)."""
    return sky_colors(sky, pixel_rays(camera))


def sky_colors(sky: NDArray[np.float32], directions: NDArray) -> NDArray[np.float32]:
    """Colours [..., 3] of a sky [h, w, 3] along world ``directions`` [..., 3], bilinear between pixel centres."""
    height, width = sky.shape[:2]
    uv = sky_coordinates(directions)
    column, row = uv[..., 0] * width - 0.5, np.clip(uv[..., 1] * height - 0.5, 0, height - 1)
    left, top = np.floor(column).astype(np.int32), np.floor(row).astype(np.int32)
    right_share, bottom_share = ((a - b).astype(np.float32)[..., None] for a, b in ((column, left), (row, top)))
    left, right, bottom = left % width, (left + 1) % width, np.minimum(top + 1, height - 1)
    colors = sky.reshape(-1, sky.shape[2])  # taken by one index, not by two: half the time

    def between(row: NDArray[np.int32]) -> NDArray[np.float32]:
        first, second = colors.take(row * width + left, 0), colors.take(row * width + right, 0)
        return first + right_share * (second - first)

    upper = between(top)
    return upper + bottom_share * (between(bottom) - upper)
