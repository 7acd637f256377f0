"""From which sides a vehicle was seen."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera
from dwgs.scene.pose import inverse, transform_points
from dwgs.scene.silhouette import NEAR

SECTORS = 12
"""Directions are counted in sectors of 30 degrees: the first about the front, turning to the left."""
SIDES = {"front": (0, 1), "rear": (0, -1), "left": (1, 1), "right": (1, -1), "top": (2, 1)}
"""Name of a side of the box to its axis and sign."""
_SAMPLES = 12


def sector_of(vehicle_from_camera: NDArray[np.float64]) -> int:
    """The sector that a camera [4, 4] looks from."""
    x, y, _ = vehicle_from_camera[:3, 3]
    return round(np.arctan2(y, x) / (2 * np.pi) * SECTORS) % SECTORS


class Coverage:
    """Adds up what each frame shows of the vehicle."""

    def __init__(self, size: NDArray) -> None:
        self.size = np.asarray(size, np.float64)
        self.sector_pixels = np.zeros(SECTORS)
        """[SECTORS] pixels of the box, by the direction it was seen from."""
        self.side_pixels = dict.fromkeys(SIDES, 0.0)
        """Pixels of each side of the box, over all frames."""
        self._looks: list[list[tuple[float, float]]] = [[] for _ in range(SECTORS)]
        """Of each sector, elevations [rad] and distances [m] of its frames."""

    def add(self, camera: Camera, world_from_vehicle: NDArray[np.float64], shown: NDArray[np.bool_]) -> None:
        """Count a frame; only pixels where ``shown`` [H, W] is True count."""
        vehicle_from_camera = inverse(world_from_vehicle) @ camera.world_from_camera
        sector = sector_of(vehicle_from_camera)
        x, y, z = vehicle_from_camera[:3, 3]
        self._looks[sector].append((np.arctan2(z, np.hypot(x, y)), np.sqrt(x * x + y * y + z * z)))
        for side, (axis, sign) in SIDES.items():
            pixels = self._pixels_of(axis, sign, camera, vehicle_from_camera, shown)
            self.side_pixels[side] += pixels
            self.sector_pixels[sector] += pixels

    def report(self) -> dict:
        """JSON values: what was seen by sector of azimuth, and pixels by side of the box."""
        return {
            "sectors": [self._sector(k) for k in range(SECTORS)],
            "side_pixels": {side: round(pixels) for side, pixels in self.side_pixels.items()},
        }

    def _sector(self, k: int) -> dict:
        looks = np.array(self._looks[k]).reshape(-1, 2)
        elevations, distances = np.degrees(looks[:, 0]), looks[:, 1]
        return {
            "azimuth_deg": 360 * k // SECTORS,
            "share": round(float(self.sector_pixels[k] / max(self.sector_pixels.sum(), 1.0)), 4),
            "frames": len(looks),
            "elevation_deg": [round(float(f(elevations)), 1) for f in (np.min, np.max)] if len(looks) else None,
            "distance_m": [round(float(f(distances)), 1) for f in (np.min, np.max)] if len(looks) else None,
        }

    def _pixels_of(self, axis, sign, camera, vehicle_from_camera, shown) -> float:
        """Area [px] of one side in one image, from a grid of patches.

        A patch of area dA with normal n at p (camera frame) covers fx fy (-n . p) dA / z^3 pixels.
        """
        steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        u, v = (steps * self.size[a] for a in range(3) if a != axis)
        grid = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2)
        patches = np.insert(grid, axis, sign * self.size[axis] / 2, axis=1)
        camera_from_vehicle = inverse(vehicle_from_camera)
        p = transform_points(camera_from_vehicle, patches)
        towards = -sign * (p @ camera_from_vehicle[:3, axis])
        before = (p[:, 2] > NEAR) & (towards > 0)
        p, towards = p[before], towards[before]
        x, y = np.floor((p @ camera.K.T)[:, :2] / p[:, 2:]).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        inside[inside] = shown[y[inside], x[inside]]
        area = np.prod(np.delete(self.size, axis)) / len(patches)
        density = camera.K[0, 0] * camera.K[1, 1] * towards / p[:, 2] ** 3
        return float((density * area)[inside].sum())
