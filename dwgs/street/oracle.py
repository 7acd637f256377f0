"""The recorded frames with the true vehicle among them, and where they changed."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from dwgs.scene.camera import Camera
from dwgs.scene.insertion import box_corners
from dwgs.scene.pose import pose
from dwgs.scene.silhouette import box_silhouette
from dwgs.street.render import render
from dwgs.street.world import Stage

MASK_MARGIN = 2
"""Pixels by which the mask goes beyond what changed."""
BODY_MARGIN = 0.2
"""How far mirrors and the like reach out of the box [m]."""
DIM_REACH = 2.3
"""How far beyond its box a vehicle can dim the skylight on the ground by a bit of a byte [m]."""


@dataclass(frozen=True)
class Oracle:
    """Renders the street with the vehicle in it, where that can make a difference, and compares."""

    recorded: Callable[[int], NDArray[np.uint8]]
    """Pixels of a recorded frame by index."""
    camera: Callable[[int], Camera]
    """Camera of a frame by index."""
    stage: Stage
    """The street with the vehicle as its last body."""
    _patches: dict[int, tuple[slice, slice, NDArray[np.uint8]]] = field(default_factory=dict, repr=False, compare=False)

    def pixels(self, index: int) -> NDArray[np.uint8]:
        """[H, W, 3] sRGB."""
        if index not in self._patches:
            self._patches[index] = self._patch(index)
        rows, columns, patch = self._patches[index]
        pixels = self.recorded(index)
        pixels[rows, columns] = patch
        return pixels

    def reactive_mask(self, index: int) -> NDArray[np.bool_]:
        """[H, W] what the vehicle, its shadow and its dimming of the skylight changed, and all of its box."""
        changed = (self.pixels(index) != self.recorded(index)).any(2)
        square = np.ones((2 * MASK_MARGIN + 1, 2 * MASK_MARGIN + 1), bool)
        camera, vehicle = self.camera(index), self.stage.movers[-1]
        box = box_silhouette(camera, vehicle.trajectory.at(camera.time), np.array(vehicle.size))
        return np.asarray(binary_dilation(changed, square), bool) | box

    def _patch(self, index: int) -> tuple[slice, slice, NDArray[np.uint8]]:
        """The rows, the columns and the new pixels of the window that the vehicle can change."""
        camera = self.camera(index)
        seen = box_silhouette(camera, *self._reach(camera.time))
        rows, columns = (np.flatnonzero(seen.any(axis)) for axis in (1, 0))
        if len(rows) == 0:
            return slice(0), slice(0), np.zeros((0, 0, 3), np.uint8)
        top, left = max(rows[0] - 3, 0), max(columns[0] - 3, 0)
        bottom, right = min(rows[-1] + 4, camera.height), min(columns[-1] + 4, camera.width)
        window = camera.crop(int(left), int(top), int(right - left), int(bottom - top))
        # the rim of the window lacks neighbours to compare with: there the recorded pixels stay
        y = slice(int(top > 0), bottom - top - int(bottom < camera.height))
        x = slice(int(left > 0), right - left - int(right < camera.width))
        patch = render(self.stage, window).pixels[y, x]
        return slice(top + y.start, top + y.stop), slice(left + x.start, left + x.stop), patch

    def _reach(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pose [4, 4] and size [3] of a box about all that the vehicle is, shades or dims."""
        vehicle = self.stage.movers[-1]
        world_from_vehicle, size = vehicle.trajectory.at(time), np.array(vehicle.size)
        body = box_corners(size + 2 * BODY_MARGIN)
        sun = np.array(self.stage.world.sun) @ world_from_vehicle[:3, :3]
        ground = -size[2] / 2 - BODY_MARGIN
        shadow = body - (body[:, 2:] - ground) * sun / sun[2]
        dimmed = box_corners(size + 2 * np.array([DIM_REACH, DIM_REACH, BODY_MARGIN]))
        points = np.concatenate([body, shadow, dimmed])
        low, high = points.min(0), points.max(0)
        return world_from_vehicle @ pose(np.eye(3), (low + high) / 2), high - low
