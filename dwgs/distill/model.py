"""The vehicle while it is learnt: body and shadow, each kept in its place."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.distill.config import Recipe
from dwgs.distill.shading import Shader
from dwgs.optimize import SplatParameters, Together
from dwgs.scene import Casting, Gaussians, Shading
from dwgs.splat import Splats

BODY_MARGIN = 0.15
"""How far a body Gaussian's centre may leave the box [m]: mirrors, antennas, annotation."""
SHADOW_HEIGHT = (-0.05, 0.12)
"""Between which heights above the ground [m] a shadow Gaussian's centre stays."""
BODY_SCALES = (0.15, 0.15, 0.15)
"""Largest standard deviations of a body Gaussian [m]: beyond it lies fog."""
SHADOW_SCALES = (0.3, 0.3, 0.02)
"""Largest standard deviations of a shadow Gaussian [m]: it stays flat."""
CUT = 1 / 255
"""A Gaussian of lower opacity is never drawn."""


class Vehicle:
    """Body and shadow, kept within their bounds.

    Args:
        body: Where it begins.
        shadow: Where it begins, as it lies at rest.
        size: [3] of the box [m].
        recipe: Rates.
        casting: How the shadow is cast, and where the body's colours learn to follow the sun; None: it turns with the
            vehicle, and they stay.
    """

    def __init__(
        self, body: Gaussians, shadow: Gaussians, size: NDArray, recipe: Recipe, casting: Casting | None = None
    ) -> None:
        limits = body_bounds(size), shadow_bounds(size, shadow)
        padded = Gaussians.concatenate([body, shadow])
        self._sh_counts = body.sh.shape[1], shadow.sh.shape[1]
        clouds = padded[: len(body)], padded[len(body) :]
        rates, scales = (recipe.body, recipe.shadow), (BODY_SCALES, SHADOW_SCALES)
        self._parts = [
            SplatParameters(cloud, rate, bounds=limit, max_scales=most)
            for cloud, rate, limit, most in zip(clouds, rates, limits, scales, strict=True)
        ]
        self._together = Together(self._parts)
        self._casting, self._body = casting, len(body)
        self._slope = np.zeros(2)
        if casting is not None:
            self._heights = torch.from_numpy(casting.heights)[:, None]
            self._shader = Shader(len(body), recipe.body.betas)
        self._average: list[Tensor] = []
        self._averaged = 0

    def __len__(self) -> int:
        return len(self.splats())

    def splats(self) -> Splats:
        """The activated Gaussians, the body's first; differentiable."""
        return self._together.splats()

    def stand(self, world_from_vehicle: NDArray[np.float64]) -> None:
        """Let the sun light the body and cast its shadow as where it stands like this, until the next step."""
        if self._casting is not None:
            self._turn(self._casting.slope_at(world_from_vehicle))

    def _turn(self, slope: NDArray[np.float64]) -> None:
        """See the sun from another heading."""
        if (slope != self._slope).any():
            turn = torch.from_numpy(slope - self._slope).float()
            self.splats().means.detach()[self._body :, :2].addcmul_(self._heights, turn)
            self._shader.turn(self.splats().sh.detach()[: self._body, 0], self._slope, slope)
            self._slope = slope

    def step(self, factor: float, is_averaged: bool) -> None:
        """One step of Adam, rates times ``factor``; ``is_averaged`` adds it to the mean of `finish`."""
        if self._slope.any():
            v_sh, slope = self.splats().sh.grad, self._slope
            self._turn(np.zeros(2))
            if v_sh is not None:
                self._shader.step(v_sh[: self._body, 0], slope, factor)
        self._together.step(factor)
        if is_averaged:
            flats = [part.flat() for part in self._parts]
            if self._casting is not None:
                flats.append(self._shader.by_slope.clone())
            self._averaged += 1
            for average, flat in zip(self._average, flats, strict=False):
                average.lerp_(flat, 1 / self._averaged)
            self._average = self._average or flats

    def state_dict(self) -> dict[str, Any]:
        """Everything that further steps and the result depend on."""
        parts = [part.state_dict() for part in self._parts]
        state = {"parts": parts, "average": self._average, "averaged": self._averaged}
        if self._casting is not None:
            state["shader"] = self._shader.state_dict()
        return state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Be what `state_dict` gave."""
        for part, saved in zip(self._parts, state["parts"], strict=True):
            part.load_state_dict(saved)
        if self._casting is not None:
            self._shader.load_state_dict(state["shader"])
        self._slope = np.zeros(2)
        self._average, self._averaged = list(state["average"]), state["averaged"]

    def finish(self) -> tuple[Gaussians, Gaussians, Casting | None, Shading | None]:
        """Body and shadow, the mean over the averaged steps, without what is too faint ever to be drawn.

        And how this shadow was cast, and this body lit.
        """
        for part, average in zip(self._parts, self._average, strict=False):
            part.load_flat(average)
        body, shadow = (part.to_gaussians() for part in self._parts)
        body, shadow = (
            replace(cloud, sh=cloud.sh[:, :count]) for cloud, count in zip((body, shadow), self._sh_counts, strict=True)
        )
        is_drawn, is_dark, casting, shading = body.opacities >= CUT, shadow.opacities >= CUT, self._casting, None
        if casting is not None:
            casting = replace(casting, heights=casting.heights[is_dark])
            by_slope = self._average[-1] if self._average else self._shader.by_slope
            shading = Shading(by_slope.numpy()[:, is_drawn].swapaxes(0, 1).copy(), self._shader.slopes)
        return body[is_drawn], shadow[is_dark], casting, shading


def vehicle_bounds(size: NDArray, shadow: Gaussians, reach: float) -> NDArray[np.float64]:
    """[2, 3] (lowest, highest corner) [m] where body and shadow may lie, if this moves by up to ``reach`` [m].

    The layers of the background hold only while they stay there.
    """
    (low, high), (shadow_low, shadow_high) = body_bounds(size), shadow_bounds(size, shadow)
    moved = np.array([reach, reach, 0.0]) * (len(shadow) > 0)
    return np.stack([np.minimum(low, shadow_low - moved), np.maximum(high, shadow_high + moved)])


def body_bounds(size: NDArray) -> NDArray[np.float64]:
    """[2, 3] where a body may lie: the box, grown sideways and up, hardly into the ground."""
    half = np.asarray(size, np.float64) / 2
    return np.array([-half - (BODY_MARGIN, BODY_MARGIN, 0.02), half + BODY_MARGIN])


def shadow_bounds(size: NDArray, shadow: Gaussians) -> NDArray[np.float64]:
    """[2, 3] where a shadow may lie: a slab over the ground as wide as where it begins."""
    ground = -float(size[2]) / 2
    if len(shadow) == 0:
        return np.array([[0, 0, ground], [0, 0, ground]])
    low, high = shadow.means[:, :2].min(0) - 0.1, shadow.means[:, :2].max(0) + 0.1
    return np.array([[*low, ground + SHADOW_HEIGHT[0]], [*high, ground + SHADOW_HEIGHT[1]]], np.float64)
