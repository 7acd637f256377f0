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
    left, top = np.floor(column).astype(int), np.floor(row).astype(int)
    right_share, bottom_share = (column - left)[..., None], (row - top)[..., None]
    left, right, bottom = left % width, (left + 1) % width, np.minimum(top + 1, height - 1)
    upper = sky[top, left] * (1 - right_share) + sky[top, right] * right_share
    lower = sky[bottom, left] * (1 - right_share) + sky[bottom, right] * right_share
    return (upper * (1 - bottom_share) + lower * bottom_share).astype(np.float32)
