"""Counts by how many frames each Gaussian was seen: what none saw is as it was put there."""

from collections.abc import Iterable, Iterator
from dataclasses import fields, replace

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.distill.shots import Shot
from dwgs.scene import Gaussians
from dwgs.splat import RetainedCloud, Splats, View
from dwgs.splat.constants import SH_C0

LEAST_PIXELS = 0.5
"""A frame sees a Gaussian that colours at least so much of its pixels, summed by weight."""


Look = tuple[Shot, View, Gaussians]
"""A frame, from where it sees the vehicle, and the vehicle as it stands there: always the same Gaussians, moved."""


def observations(looks: Iterable[Look], count: int, threads: int) -> NDArray[np.uint32]:
    """[count] how many of the frames saw each of the first Gaussians, where they were compared with them."""
    counts = np.zeros(count, np.uint32)
    for pixels in _pixels_shown(looks, count, threads):
        counts += pixels > LEAST_PIXELS
    return counts


def _pixels_shown(looks: Iterable[Look], count: int, threads: int) -> Iterator[NDArray[np.float32]]:
    """[count] of every frame in turn: how many of its compared pixels each of the first Gaussians colours, by weight.

    The weight of a Gaussian in an image is the image's derivative by its colour.
    """
    cloud: RetainedCloud | None = None
    for shot, view, vehicle in looks:
        cloud = cloud or _grey(vehicle, threads)
        for name in ("means", "quats"):
            getattr(cloud.splats, name).detach().copy_(torch.from_numpy(getattr(vehicle, name)))
        picture = shot.frozen.retain(cloud, view)
        drawing = picture.draw()
        for gradient in (drawing.v_rgb, drawing.v_depth, drawing.v_alpha):
            gradient.zero_()
        drawing.v_rgb[..., 0] = torch.from_numpy(shot.sight.region.supervised).float()
        picture.adjoint()
        by_color = cloud.splats.sh.grad
        assert by_color is not None
        yield (by_color[:count, 0, 0] / SH_C0).numpy()


def _grey(vehicle: Gaussians, threads: int) -> RetainedCloud:
    """The same, far from where colours are cut off."""
    splats = replace(Splats.from_gaussians(vehicle), sh=torch.zeros(len(vehicle), 1, 3))
    return RetainedCloud(Splats(*(getattr(splats, f.name).requires_grad_() for f in fields(splats))), threads)
