"""Counts by how many frames each Gaussian was seen: what none saw is as it was put there."""

from collections.abc import Iterable, Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.distill.shots import Shot
from dwgs.scene import VehicleAsset
from dwgs.splat import RetainedCloud, Splats, View
from dwgs.splat.constants import SH_C0

LEAST_PIXELS = 0.5
"""A frame sees a Gaussian that colours at least so much of its pixels, summed by weight."""


def observations(shots: Iterable[tuple[Shot, View]], asset: VehicleAsset, threads: int) -> NDArray[np.uint32]:
    """[body] how many of the frames saw each of the body's Gaussians, where they were compared with it."""
    counts = np.zeros(len(asset.body), np.uint32)
    for pixels in pixels_shown(shots, asset, threads):
        counts += pixels > LEAST_PIXELS
    return counts


def pixels_shown(
    shots: Iterable[tuple[Shot, View]], asset: VehicleAsset, threads: int
) -> Iterator[NDArray[np.float32]]:
    """[body] of every frame in turn: how many of its compared pixels each Gaussian of the body colours, by weight.

    The weight of a Gaussian in an image is the image's derivative by its colour.
    """
    body = asset.body
    splats = Splats.from_gaussians(asset.gaussians)
    grey = torch.zeros(len(splats), 1, 3)  # far from where colours are cut off
    leaves = (splats.means, splats.quats, splats.scales, splats.opacities, grey)
    cloud = RetainedCloud(Splats(*(leaf.contiguous().requires_grad_() for leaf in leaves)), threads)
    shadow_means = cloud.splats.means.detach()[len(body) :]
    for shot, view in shots:
        shadow = asset.shadow_at(shot.sight.world_from_vehicle)
        shadow_means.copy_(torch.from_numpy(shadow.means))
        picture = shot.frozen.retain(cloud, view)
        drawing = picture.draw()
        for gradient in (drawing.v_rgb, drawing.v_depth, drawing.v_alpha):
            gradient.zero_()
        drawing.v_rgb[..., 0] = torch.from_numpy(shot.sight.region.supervised).float()
        picture.adjoint()
        by_color = cloud.splats.sh.grad
        assert by_color is not None
        yield (by_color[: len(body), 0, 0] / SH_C0).numpy()
