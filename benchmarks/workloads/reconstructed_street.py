"""The embedded street as its reconstruction shows it, and the true vehicle in that: a world made of Gaussians.

Rivals render the background that the true street has pixels for. So that its errors judge nobody, the reconstruction
becomes the recording: whatever renders it, exactly or as a flat image, has the background right.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from dwgs.distill.layers import FrozenBackground
from dwgs.scene import Background, Camera, Frame, Insertion, Scene
from dwgs.splat import View
from dwgs.street import Street

RIM = 4
"""Pixels of a window beyond what the vehicle changes: at its rim the street sees no edges."""


def oracle(street: Street, insertion: Insertion, background: Background) -> tuple[Scene, Background]:
    """A video of the true vehicle before ``background``, and that as the video's cameras see it."""
    background = Background(background.gaussians, background.sky)  # as recorded: nothing is refined, nothing exposed
    truth, frozen = street.oracle(insertion), FrozenBackground(background, ())

    def moved(frame: Frame) -> Frame:
        return replace(frame, load_pixels=partial(_pixels, street, insertion, frame, frozen))

    frames = {name: tuple(map(moved, frames)) for name, frames in truth.frames.items()}
    name = f"{street.scene().name}-reconstructed-oracle"
    return replace(truth, name=name, frames=frames, sweeps=(), tracks=()), background


def _pixels(street: Street, insertion: Insertion, frame: Frame, frozen: FrozenBackground) -> NDArray[np.uint8]:
    """[H, W, 3] the background; where the vehicle is, that; where its shadow is, as much darker as the street is."""
    pixels = _alone(frozen, frame.camera, frame.camera_name)
    mask = frame.reactive_mask
    if mask is not None and mask.any():
        rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
        top, left = max(int(rows[0]) - RIM, 0), max(int(columns[0]) - RIM, 0)
        window = np.s_[top : rows[-1] + RIM + 1, left : columns[-1] + RIM + 1]
        height, width = mask[window].shape
        camera = frame.camera.crop(left, top, width, height)
        share = street.view(camera, camera.time, insertion).vehicle_alpha
        edited, recorded = (a[window].astype(np.float32) for a in (frame.pixels, street.pixels(frame.index)))
        light = np.minimum(edited / np.maximum(recorded, 1), 1)
        # Where the vehicle covers a part of a pixel, the ground is lit as beside it.
        nearest = np.asarray(distance_transform_edt(share > 0, return_distances=False, return_indices=True))
        behind = (1 - share)[..., None] * light[tuple(nearest)] * (pixels[window] - recorded)
        changed = np.clip(edited + behind, 0, 255).round().astype(np.uint8)
        pixels[window] = np.where(mask[window][..., None], changed, pixels[window])
    return pixels


def _alone(frozen: FrozenBackground, camera: Camera, camera_name: str) -> NDArray[np.uint8]:
    everything_behind = (0.0, 0.0)
    view = frozen.freeze(camera, camera_name, everything_behind)
    rgb = view.alone(View.from_camera(camera)).clamp(0, 1).numpy()
    return (rgb * 255).round().astype(np.uint8)
