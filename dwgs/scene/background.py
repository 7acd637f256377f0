"""The street without the vehicle, frozen once it is reconstructed."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.gaussians import Gaussians


@dataclass(frozen=True)
class Background:
    """Static Gaussians in the world, a sky behind them, and how each camera exposes."""

    gaussians: Gaussians
    """World frame [m]."""
    sky: NDArray[np.float32]
    """[H, W, 3] sRGB in [0, 1], equirectangular: row 0 is straight up, the last row straight down; column 0
    looks along -x and the azimuth grows with the column (`sky_coordinates`)."""
    exposure: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Camera name to gain [3] on the rendered colour; a camera not named has gain 1."""
    poses: dict[tuple[str, int], NDArray[np.float64]] = field(default_factory=dict)
    """(camera name, frame index) to the refined ``world_from_camera`` [4, 4] it was fitted with."""

    def __post_init__(self) -> None:
        if self.sky.ndim != 3 or self.sky.shape[2] != 3 or self.sky.dtype != np.float32:
            raise InputError(f"a sky is a float32 image [H, W, 3], got {self.sky.dtype} {self.sky.shape}")


def sky_coordinates(directions: NDArray) -> NDArray[np.float64]:
    """(u, v) in [0, 1] [..., 2] into `Background.sky` for world directions [..., 3] of any length.

    u = atan2(y, x) / 2pi + 0.5, v = acos(z) / pi: the centre of pixel (row, column) lies at
    ((column + 0.5) / W, (row + 0.5) / H).
    """
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    u = np.arctan2(y, x) / (2 * np.pi) + 0.5
    v = np.arctan2(np.hypot(x, y), z) / np.pi
    return np.stack([u, v], -1)
