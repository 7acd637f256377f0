"""The recorded frames with the true vehicle among them, and where they changed."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation
from scipy.spatial import ConvexHull

from dwgs.scene.camera import Camera
from dwgs.scene.insertion import box_corners
from dwgs.scene.pose import transform_points
from dwgs.street.render import render
from dwgs.street.world import Stage

MASK_MARGIN = 2
"""Pixels by which the mask goes beyond what changed."""


@dataclass(frozen=True)
class Oracle:
    """Renders the street with the vehicle in it, and compares."""

    recorded: Callable[[int], NDArray[np.uint8]]
    """Pixels of a recorded frame by index."""
    camera: Callable[[int], Camera]
    """Camera of a frame by index."""
    stage: Stage
    """The street with the vehicle as its last body."""
    _kept: dict[int, NDArray[np.uint8]] = field(default_factory=dict, repr=False, compare=False)

    def pixels(self, index: int) -> NDArray[np.uint8]:
        """[H, W, 3] sRGB."""
        if index not in self._kept:
            self._kept[index] = render(self.stage, self.camera(index)).pixels
        return self._kept[index].copy()

    def reactive_mask(self, index: int) -> NDArray[np.bool_]:
        """[H, W] what the vehicle, its shadow and its dimming of the skylight changed, and all of its box."""
        changed = (self.pixels(index) != self.recorded(index)).any(2)
        square = np.ones((2 * MASK_MARGIN + 1, 2 * MASK_MARGIN + 1), bool)
        return binary_dilation(changed, square) | self._silhouette(index)

    def _silhouette(self, index: int) -> NDArray[np.bool_]:
        """[H, W] the filled outline of the vehicle's box."""
        camera, vehicle = self.camera(index), self.stage.movers[-1]
        corners = transform_points(vehicle.trajectory.at(camera.time), box_corners(np.array(vehicle.size)))
        return silhouette(camera, corners)


def silhouette(camera: Camera, corners: NDArray[np.float64], near: float = 0.1) -> NDArray[np.bool_]:
    """[H, W] the image of the convex hull of points [N, 3] in the world, cut off at the near plane [m]."""
    p = transform_points(camera.camera_from_world, corners)
    front, behind = p[p[:, 2] >= near], p[p[:, 2] < near]
    if len(front) == 0:
        return np.zeros((camera.height, camera.width), bool)
    # where the hull crosses the near plane: among all lines from a point before it to one behind
    share = (near - behind[None, :, 2]) / (front[:, None, 2] - behind[None, :, 2])
    crossing = behind[None] + share[..., None] * (front[:, None] - behind[None])
    seen = np.concatenate([front, crossing.reshape(-1, 3)]) @ camera.K.T
    pixels = seen[:, :2] / seen[:, 2:]
    outline = pixels[ConvexHull(pixels).vertices]
    image = Image.new("1", (camera.width, camera.height))
    ImageDraw.Draw(image).polygon([tuple(q) for q in outline - 0.5], fill=1, outline=1)
    return np.array(image)
