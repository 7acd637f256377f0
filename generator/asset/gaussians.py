"""An asset out of a vehicle's points: flat Gaussians on its surface, and darkness beneath it."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Gaussians, VehicleAsset, VehiclePoints
from dwgs.scene.color import srgb_from_linear
from dwgs.splat.constants import SH_C0
from generator.composite.surface import surface_of

SPREAD, FLATNESS = 0.8, 0.15
"""Standard deviation of a Gaussian over the radius of its disc: in the surface, and across it."""
OPACITY = 0.95
"""Of a Gaussian on the body: what lies behind four of them is gone."""
SPACING = 0.08
"""Between Gaussians of the shadow [m]."""
LIFT = 0.04
"""Height of the shadow above the ground [m]: sorted by centre, a disc in the road would sink into it."""
DEPTH, FADE = 0.3, 0.5
"""Opacity of one Gaussian under the vehicle, where four overlap, and how far beside it the shadow ends [m]."""
DARKNESS = 0.03
"""Grey value of the shadow."""


def asset_of(vehicle: VehiclePoints, size: NDArray, seed: int = 0) -> VehicleAsset:
    """A vehicle of ``size`` [3] [m] as Gaussians with the colours that its points have, whatever light that was."""
    surface = surface_of(vehicle, size, seed)
    scales = surface.radii[:, None] * np.array([SPREAD, SPREAD, SPREAD * FLATNESS], np.float32)
    colors = srgb_from_linear(surface.colors)
    body = _cloud(surface.points, _quats_about(surface.normals), scales, np.full(len(scales), OPACITY), colors)
    return VehicleAsset(body, contact_shadow(size), np.asarray(size, np.float64))


def contact_shadow(size: NDArray) -> Gaussians:
    """Dark discs flat on the ground under a vehicle, fainter towards `FADE` beside it (as HUGSIM's assets have)."""
    half = np.asarray(size, np.float64)[:2] / 2
    x, y = (np.arange(SPACING / 2 - h - FADE, h + FADE, SPACING) for h in half)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    beside = np.linalg.norm(np.maximum(np.abs(places) - half, 0), axis=1)
    opacities = DEPTH * np.clip(1 - beside / FADE, 0, 1) ** 2
    places, opacities = places[opacities > 0.01], opacities[opacities > 0.01]
    means = np.column_stack([places, np.full(len(places), LIFT - size[2] / 2)])
    up = np.tile(np.array([0.0, 0.0, 1.0]), (len(means), 1))
    scales = np.tile(np.array([0.7 * SPACING, 0.7 * SPACING, 0.01]), (len(means), 1))
    return _cloud(means, _quats_about(up), scales, opacities, np.full((len(means), 3), DARKNESS))


def _cloud(means: NDArray, quats: NDArray, scales: NDArray, opacities: NDArray, colors: NDArray) -> Gaussians:
    arrays = (means, quats, scales, opacities, ((colors - 0.5) / SH_C0)[:, None])
    return Gaussians(*(np.ascontiguousarray(a, np.float32) for a in arrays))


def _quats_about(normals: NDArray) -> NDArray[np.float64]:
    """The shortest turns [N, 4] (w, x, y, z) that carry the z axis to unit normals [N, 3]."""
    x, y, z = np.asarray(normals, np.float64).T
    quats = np.stack([1 + z, -y, x, np.zeros_like(z)], 1)
    quats[z < -1 + 1e-9] = (0, 1, 0, 0)  # straight down: about any axis
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)
