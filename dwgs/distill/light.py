"""The light that a vehicle stands in, from what the frames show of its paint.

A surface of albedo a and normal n, of which the share m is mirrored (see `lacquer`), has the linear colour

    (1 - sum m) a (sky + slope n_z + sun max(n . s, 0)) + sum m surroundings

Sky from above and around, a sun from the direction s, and what lacquer and glass mirror of the ground, of what stands
around, and of the sky. Given s it is linear in all else. Where a shadow does not say where the sun stands, directions
over all the sky are tried, and each counts by how well it explains the frames: where they hardly tell, the light is the
mean of all that agree with them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.distill.appearance import Appearance
from dwgs.distill.lacquer import PARTS
from dwgs.scene.color import linear_from_srgb

SUNS = 96
"""Directions that are tried."""
SAMPLES = 100_000
"""About so many discs tell, in all, under all directions that are tried."""
ROUNDS = 6
"""So often errors say anew what each disc counts; after 3 the sun was a quarter too weak."""
ROBUST, MOST = 0.05, 0.1
"""Errors [sRGB] beyond the first count less in the fit, beyond the second no more when suns are compared."""
DOUBT = 0.03
"""A sun whose error is larger than the least by this share counts 1/e."""
USUAL = np.array([1.0, 0.2, 1.5, *[0.3] * PARTS])
"""Size of sky, slope, sun and what is mirrored, as far as is known beforehand ..."""
INDEPENDENT = 10.0
"""... and what the frames say counts as so many independent looks, each as wrong as `ROBUST`."""
GREY = 0.3
"""Holds each channel near all channels, by this share of what it says itself: a red car tells little of blue light."""
HOPELESS = 1.5
"""A sun whose error is so many times the least is tried no more."""
DARK = 1.0
"""Error of a sky or a sun that takes light away: there is none."""
DARKEST = 0.02
"""Irradiance that is left anywhere."""


@dataclass(frozen=True)
class Light:
    """Suns that may be, and what each says of the rest."""

    suns: NDArray[np.float64]
    """[S, 3] directions in the vehicle's frame."""
    shares: NDArray[np.float64]
    """[S] how likely, sum 1."""
    terms: NDArray[np.float64]
    """[S, 3 + PARTS, 3] sky, slope, sun, and the parts that are mirrored."""

    def shown(self, paints: NDArray, normals: NDArray, mirrored: NDArray) -> NDArray[np.float64]:
        """Linear colours [N, 3] of surfaces of that paint (sRGB) which mirror those shares [N, PARTS]."""
        terms = self.shares[:, None, None] * self.terms
        sky, slope, around = terms[:, 0].sum(0), terms[:, 1].sum(0), terms[:, 3:].sum(0)
        irradiance = sky + slope * normals[:, 2:] + np.maximum(normals @ self.suns.T, 0) @ terms[:, 2]
        kept = 1 - mirrored.sum(1, keepdims=True)
        return kept * linear_from_srgb(paints) * np.maximum(irradiance, DARKEST) + mirrored @ around


def find_light(paints: NDArray, appearance: Appearance, sun: NDArray | None = None) -> Light:
    """The light under which discs of these paints [N, 3] (sRGB) look as they do, from a ``sun`` [3] if it is known."""
    suns = _sky_directions(SUNS) if sun is None else np.reshape(sun, (1, 3))
    seen = np.flatnonzero(appearance.is_seen)
    seen = seen[:: len(seen) * len(suns) // SAMPLES + 1]
    albedo, shown = linear_from_srgb(paints[seen]), linear_from_srgb(np.clip(appearance.colors[seen], 0, 1))
    normals, pixels, mirrored = appearance.normals[seen], appearance.pixels[seen], appearance.mirrored[seen]
    weight = np.minimum(pixels, np.quantile(pixels, 0.9))
    weight = weight / weight.sum()
    slope = _srgb_slope(shown)

    facing = np.maximum(normals @ suns.T, 0).T
    lit = np.stack([np.ones_like(facing), np.broadcast_to(normals[:, 2], facing.shape), facing], 1)
    lit *= 1 - mirrored.sum(1)
    around = np.broadcast_to(mirrored.T, (len(suns), PARTS, len(seen)))
    design = np.stack([np.concatenate([lit * albedo[:, c], around], 1) for c in range(3)], 1)  # [S, 3, 3 + PARTS, M]
    trust = np.ones((len(suns), 3, len(seen)))
    terms, costs = np.zeros((len(suns), 3, len(USUAL))), np.zeros(len(suns))
    prior = (ROBUST / USUAL) ** 2 / INDEPENDENT
    for _ in range(ROUNDS):
        weighted = design * (trust * weight * (slope.T) ** 2)[:, :, None]
        matrix = weighted @ design.swapaxes(-1, -2)
        right = np.einsum("schm,cm->sch", weighted, shown.T)
        grey = np.linalg.solve(matrix.sum(1) + np.diag(prior), right.sum(1)[..., None])[..., 0]
        held = (GREY * np.einsum("sckk->sk", matrix) + prior)[:, None]
        terms = np.linalg.solve(matrix + _diagonal(held), (right + held * grey[:, None])[..., None])[..., 0]
        error = np.abs(np.einsum("schm,sch->scm", design, terms) - shown.T) * slope.T
        costs = (weight * np.minimum(error, MOST) ** 2).sum((1, 2)) + DARK * (terms.mean(1)[:, [0, 2]] < 0).any(1)
        likely = costs <= HOPELESS * costs.min()
        suns, design, terms, costs = suns[likely], design[likely], terms[likely], costs[likely]
        trust = 1 / np.maximum(error[likely] / ROBUST, 1)
    shares = np.exp(-(costs / max(costs.min(), 1e-9) - 1) / DOUBT)
    return Light(suns, shares / shares.sum(), terms.swapaxes(1, 2))


def _srgb_slope(light: NDArray) -> NDArray[np.float64]:
    """Derivative of sRGB by linear light, which near black does not grow beyond reason."""
    return 1.055 / 2.4 * np.maximum(light, 0.01) ** (1 / 2.4 - 1)


def _sky_directions(count: int) -> NDArray[np.float64]:
    """[count, 3] evenly over the upper half of the sphere."""
    k = np.arange(count) + 0.5
    z, turn = k / count, np.pi * (1 + 5**0.5) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)


def _diagonal(values: NDArray) -> NDArray[np.float64]:
    """[..., K, K] with these [..., K]."""
    return values[..., None] * np.eye(values.shape[-1])
