"""The light that a vehicle stands in, from what the frames show of its paint.

A surface of albedo a and normal n, seen under the cosine c, has the linear colour

    a (sky + slope n_z + sun max(n . s, 0)) + gloss + mirror (1 - c)^5

Sky from above and around, a sun from the direction s, and what glossy paint and glass mirror of the surroundings, more
at grazing angles (Schlick, "An inexpensive BRDF model for physically-based rendering", 1994). Given s it is linear in
all else. Directions over all the sky are tried, and each counts by how well it explains the frames: where they hardly
tell, the light is the mean of all that agree with them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.distill.appearance import Appearance
from dwgs.scene.color import linear_from_srgb

SUNS = 96
"""Directions that are tried."""
SAMPLES = 2000
"""About so many discs tell."""
ROBUST, MOST = 0.05, 0.1
"""Errors [sRGB] beyond the first count less in the fit, beyond the second no more when suns are compared."""
DOUBT = 0.03
"""A sun whose error is larger than the least by this share counts 1/e."""
USUAL = np.array([1.0, 0.2, 1.5, 0.05, 0.3])
"""Size of sky, slope, sun, gloss and mirror, as far as is known beforehand ..."""
INDEPENDENT = 10.0
"""... and what the frames say counts as so many independent looks, each as wrong as `ROBUST`."""
GREY = 0.3
"""Holds each channel near all channels, by this share of what it says itself: a red car tells little of blue light."""
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
    """[S, 5, 3] sky, slope, sun, gloss, mirror."""

    def diffuse(self, paints: NDArray, normals: NDArray) -> NDArray[np.float64]:
        """Linear colours [N, 3] of surfaces of that paint (sRGB), seen from ahead."""
        sky, slope, sun, gloss, _ = (self.shares[:, None, None] * self.terms).swapaxes(0, 1)
        sunlit = np.maximum(normals @ self.suns.T, 0) @ sun
        irradiance = sky.sum(0) + slope.sum(0) * normals[:, 2:] + sunlit
        return linear_from_srgb(paints) * np.maximum(irradiance, DARKEST) + gloss.sum(0)

    def mirrored(self, cosines: NDArray) -> NDArray[np.float64]:
        """Linear colours [N, 3] that surfaces seen under these cosines mirror beyond that."""
        return fresnel(cosines)[:, None] * (self.shares @ self.terms[:, 4])


def find_light(paints: NDArray, appearance: Appearance) -> Light:
    """The light under which discs of these paints [N, 3] (sRGB) look as they do."""
    seen = np.flatnonzero(appearance.is_seen)
    seen = seen[:: len(seen) // SAMPLES + 1]
    albedo, shown = linear_from_srgb(paints[seen]), linear_from_srgb(np.clip(appearance.colors[seen], 0, 1))
    normals, pixels = appearance.normals[seen], appearance.pixels[seen]
    weight = np.minimum(pixels, np.quantile(pixels, 0.9))
    weight = weight / weight.sum()
    slope = _srgb_slope(shown)
    suns = _sky_directions(SUNS)

    one, mirror = np.ones(len(seen)), fresnel(appearance.cosines[seen])
    facing = np.maximum(normals @ suns.T, 0)
    lit = np.stack([np.broadcast_to(one, facing.T.shape), np.broadcast_to(normals[:, 2], facing.T.shape), facing.T], 1)
    glossy = np.broadcast_to(np.stack([one, mirror]), (SUNS, 2, len(seen)))
    design = np.stack([np.concatenate([lit * albedo[:, c], glossy], 1) for c in range(3)], 1)  # [S, 3, 5, M]
    trust = np.ones((SUNS, 3, len(seen)))
    terms, error = np.zeros((SUNS, 3, 5)), trust
    prior = (ROBUST / USUAL) ** 2 / INDEPENDENT
    for _ in range(3):
        weighted = design * (trust * weight * (slope.T) ** 2)[:, :, None]
        matrix = weighted @ design.swapaxes(-1, -2)
        right = np.einsum("schm,cm->sch", weighted, shown.T)
        grey = np.linalg.solve(matrix.sum(1) + np.diag(prior), right.sum(1)[..., None])[..., 0]
        held = (GREY * np.einsum("sckk->sk", matrix) + prior)[:, None]
        terms = np.linalg.solve(matrix + _diagonal(held), (right + held * grey[:, None])[..., None])[..., 0]
        error = np.abs(np.einsum("schm,sch->scm", design, terms) - shown.T) * slope.T
        trust = 1 / np.maximum(error / ROBUST, 1)
    costs = (weight * np.minimum(error, MOST) ** 2).sum((1, 2)) + DARK * (terms.mean(1)[:, [0, 2]] < 0).any(1)
    shares = np.exp(-(costs / max(costs.min(), 1e-9) - 1) / DOUBT)
    return Light(suns, shares / shares.sum(), terms.swapaxes(1, 2))


def fresnel(cosines: NDArray) -> NDArray[np.float64]:
    """Share of what a surface mirrors more because it is seen at this angle."""
    return (1 - np.clip(cosines, 0, 1)) ** 5


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
