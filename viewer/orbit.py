"""A vehicle turning in a plain studio, as one shows it to people."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera, VehicleAsset
from dwgs.scene.insertion import box_corners
from dwgs.scene.pose import pose

FIRST_AZIMUTH = np.radians(35)
"""Where the turn begins [rad], from straight ahead towards the left: a front quarter shows most."""
FILLED = 0.82
"""Share of the image's width or height that the vehicle fills where it looks largest."""


def _studio() -> NDArray[np.float32]:
    height = np.cos((np.arange(512) + 0.5) / 512 * np.pi)  # of the direction above the horizon, 1 to -1
    falloff = np.where(height > 0, 0.30 * (1 - np.exp(-3.0 * height)), 0.20 * (1 - np.exp(2.2 * height)))
    gray = 0.93 - falloff
    return (gray[:, None, None] * np.array([0.985, 0.995, 1.0])).astype(np.float32)


BACKDROP = _studio()
"""[H, 1, 3] light ground before a soft grey wall: brightest at the horizon, no edge anywhere."""


def orbit_cameras(asset: VehicleAsset, count: int, width: int, height: int, elevation: float = 0.24) -> list[Camera]:
    """``count`` cameras once round the asset, which stands in the world's origin at time 0.

    All have one distance, just far enough that the box fits into every image; ``elevation`` [rad] is above
    the horizon. The last camera is one step before the first, so that the turn can be repeated.
    """
    focal = 1.6 * max(width, height)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    azimuths = FIRST_AZIMUTH + 2 * np.pi * np.arange(count) / count
    rotations = [_towards_origin(azimuth, elevation) for azimuth in azimuths]
    distance = max(_fitting_distance(box_corners(asset.size) @ r, K, width, height) for r in rotations)
    return [Camera(K, width, height, pose(r, -distance * r[:, 2]), time=0.0) for r in rotations]


def _towards_origin(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """``world_from_camera`` rotation [3, 3] of a level camera that looks at the origin from there."""
    forward = -np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0])
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def _fitting_distance(corners: NDArray, K: NDArray, width: int, height: int) -> float:
    """How far [m] a camera must stand back to see ``corners`` [8, 3], given in its axes about the target."""
    tangents = FILLED * np.array([width / K[0, 0], height / K[1, 1]]) / 2
    return float((np.abs(corners[:, :2]) / tangents - corners[:, 2:]).max())
