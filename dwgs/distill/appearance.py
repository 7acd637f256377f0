"""What colours the frames show on the discs that a body begins with: no fit, only a look from each camera."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from dwgs.distill.lacquer import PARTS, mirrored
from dwgs.distill.shots import Shot
from dwgs.scene import Gaussians
from dwgs.scene.pose import rotation_from_quat
from dwgs.scene.silhouette import NEAR
from dwgs.splat import Splats, render

SOLID = 0.98
"""Opacity of discs that hide what is behind them."""
COVERED = 0.9
"""A pixel that less of the discs covers shows background, too."""
CLEAR = 0.99
"""A pixel through which less is seen shows what stands before the vehicle."""
BEHIND = 0.08
"""A disc deeper [m] than what the pixel shows is hidden."""
GRAZING = 0.12
"""A disc turned so far away, by the cosine, shows nothing of its own."""


@dataclass(frozen=True)
class Appearance:
    """Colours of discs in the frames, means over pixels."""

    normals: NDArray[np.float64]
    """[N, 3] outward."""
    colors: NDArray[np.float64]
    """[N, 3] sRGB before exposure; 0 where none was seen."""
    pixels: NDArray[np.float64]
    """[N] how many showed it."""
    mirrored: NDArray[np.float64]
    """[N, PARTS] shares of its surroundings that it mirrored, see `lacquer`."""

    @property
    def is_seen(self) -> NDArray[np.bool_]:
        """[N] whether any pixel showed it."""
        return self.pixels > 0


def look(body: Gaussians, shots: Sequence[Shot], are_outward: bool, threads: int) -> Appearance:
    """Project the discs into the frames; they hide each other.

    Args:
        body: Discs about the last of their axes.
        shots: Frames; a few from each side are enough.
        are_outward: Whether that axis points outward; else it is taken to point away from the centre.
        threads: Frames at a time.
    """
    normals = rotation_from_quat(body.quats)[:, :, 2]
    if not are_outward:
        inward = (normals * body.means / np.ptp(body.means, axis=0).clip(0.1) ** 2).sum(1) < 0
        normals[inward] *= -1
    solid = Splats.from_gaussians(replace(body, opacities=np.full(len(body), SOLID, np.float32)))
    areas = np.pi * body.scales[:, 0] * body.scales[:, 1]
    with ThreadPoolExecutor(threads) as pool:
        looks = pool.map(lambda shot: _look_once(body, normals, areas, solid, shot), shots)
        pixels, colors, shares = (np.sum(parts, 0) for parts in zip(*looks, strict=True))
    mean = 1 / np.maximum(pixels, 1e-12)[:, None]
    return Appearance(normals, colors * mean, pixels, shares * mean)


def _look_once(body, normals, areas, solid, shot):
    """Pixels [N] of each disc in one frame, and sums over them of colours [N, 3] and what is mirrored [N, PARTS]."""
    with torch.no_grad():
        rendering = render(solid, shot.view, threads=1)
    depth = rendering.expected_depth.numpy()
    shows = (rendering.alpha > COVERED) & (shot.frozen.layers.front_transmittance > CLEAR)
    shows = shows.numpy() & shot.sight.region.supervised
    camera_from_vehicle = shot.view.viewmat.double().numpy()
    in_camera = body.means @ camera_from_vehicle[:3, :3].T + camera_from_vehicle[:3, 3]
    toward = -in_camera @ camera_from_vehicle[:3, :3]
    cosines = (normals * toward).sum(1) / np.linalg.norm(toward, axis=1)
    fx, fy, cx, cy = shot.view.intrinsics
    z = np.maximum(in_camera[:, 2], NEAR)
    x, y = fx * in_camera[:, 0] / z + cx, fy * in_camera[:, 1] / z + cy
    is_shown = (in_camera[:, 2] > NEAR) & (x >= 0) & (x < shot.view.width) & (y >= 0) & (y < shot.view.height)
    is_shown &= cosines > GRAZING
    column, row = np.floor(x[is_shown]).astype(int), np.floor(y[is_shown]).astype(int)
    is_shown[is_shown] = shows[row, column] & (z[is_shown] < depth[row, column] + BEHIND)
    pixels, colors, shares = np.zeros(len(body)), np.zeros((len(body), 3)), np.zeros((len(body), PARTS))
    pixels[is_shown] = (areas * cosines * fx * fy / z**2)[is_shown]
    image = shot.pixels.astype(np.float32) / 255 / shot.frozen.gain.numpy()
    places = y[is_shown] - 0.5, x[is_shown] - 0.5
    for c in range(3):
        colors[is_shown, c] = map_coordinates(image[..., c], places, order=1, mode="nearest")
    shares[is_shown] = mirrored(normals[is_shown], toward[is_shown])
    return pixels, colors * pixels[:, None], shares * pixels[:, None]
