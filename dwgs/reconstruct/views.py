"""The frames as a fit wants them: pixels without traffic, depths, who teaches and who judges."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.reconstruct.depth_samples import depth_samples
from dwgs.reconstruct.inpaint import fill_smoothly
from dwgs.reconstruct.moving_mask import moving_mask
from dwgs.reconstruct.unseen import meet_ground
from dwgs.scene import Camera, Frame, Scene
from dwgs.scene.ground import Ground
from dwgs.scene.sky import pixel_rays

HELD_OUT_EVERY = 8
"""One instant in so many judges and never teaches."""
HELD_OUT_FIRST = 4
"""The first instant that judges: neither end of the drive, so that both neighbours are known."""


PAINT_STRIDE = 4
"""Traffic is painted over in blocks of this many pixels: the result is smooth anyway."""


@dataclass(frozen=True)
class TrainingView:
    """One frame, read once."""

    frame: Frame
    """Where it comes from."""
    camera: Camera
    """Of the frame as recorded, with as many pixels as this view has."""
    pixels: NDArray[np.uint8]
    """[H, W, 3]; where hidden, a smooth continuation of the surroundings: nothing of the traffic is left."""
    hidden: NDArray[np.bool_]
    """[H, W] pixels of traffic, and of what a generator repainted: they say nothing about the street."""

    depth_pixels: NDArray[np.int64]
    """[S, 2] (row, column) where the LiDAR of the same instant says how deep the street is."""
    depths: NDArray[np.float32]
    """[S] how deep [m]."""

    def halved(self) -> "TrainingView":
        """The same view with a quarter of the pixels."""
        height, width = (n // 2 for n in self.hidden.shape)
        blocks = self.pixels[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
        hidden = self.hidden[: 2 * height, : 2 * width].reshape(height, 2, width, 2)
        K = np.diag([0.5, 0.5, 1]) @ self.camera.K
        # One depth a pixel: gradients of two would be added up in whichever order threads arrive.
        index, first = np.unique(self.depth_pixels // 2, axis=0, return_index=True)
        inside = (index < (height, width)).all(1)
        return TrainingView(
            self.frame,
            replace(self.camera, K=K, width=width, height=height),
            np.round(blocks.mean((1, 3), np.float32)).astype(np.uint8),
            np.asarray(hidden.any((1, 3))),
            index[inside],
            self.depths[first[inside]],
        )


def split_frames(scene: Scene) -> tuple[list[Frame], list[Frame]]:
    """Frames that teach and frames that judge; the cameras of one instant stay together."""
    instants = sorted({frame.index for frame in scene.all_frames()})
    judging = set(instants[HELD_OUT_FIRST::HELD_OUT_EVERY])
    frames = scene.all_frames()
    return [f for f in frames if f.index not in judging], [f for f in frames if f.index in judging]


def read_view(scene: Scene, frame: Frame, ground: Ground, points: NDArray[np.float32]) -> TrainingView:
    """The frame with its traffic painted over; static ``points`` [P, 3] of its sweep give depths."""
    hidden = moving_mask(scene, frame)
    reactive = frame.reactive_mask
    if reactive is not None:
        hidden |= reactive
    pixels = paint_over(frame.pixels, hidden, frame.camera, ground) if hidden.any() else frame.pixels
    index, depths = depth_samples(points, frame.camera)
    shown = ~hidden[index[:, 0], index[:, 1]]
    return TrainingView(frame, frame.camera, pixels, hidden, index[shown], depths[shown])


def paint_over(
    pixels: NDArray[np.uint8], hidden: NDArray[np.bool_], camera: Camera, ground: Ground
) -> NDArray[np.uint8]:
    """The image [H, W, 3] with ``hidden`` [H, W] a smooth continuation: road goes on as road, the rest as the rest."""
    coarse = camera.resize(-(-camera.width // PAINT_STRIDE), -(-camera.height // PAINT_STRIDE))
    rays = pixel_rays(coarse)
    _, arrives = meet_ground(ground, camera.position, rays.reshape(-1, 3))
    is_road = arrives.reshape(rays.shape[:2]).repeat(PAINT_STRIDE, 0).repeat(PAINT_STRIDE, 1)
    is_road = is_road[: camera.height, : camera.width]
    image, painted = torch.from_numpy(pixels).float(), pixels.copy()
    for part in (is_road, ~is_road):
        if (hidden & part).any() and (part & ~hidden).any():
            smooth = fill_smoothly(image, torch.from_numpy(part & ~hidden).float(), PAINT_STRIDE)
            painted[hidden & part] = smooth.round().byte().numpy()[hidden & part]
    return painted


def evenly(items: list, count: int) -> list:
    """At most ``count`` of them, from the first to the last at equal strides."""
    if len(items) <= count:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]
