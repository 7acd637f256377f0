"""Trainable parameters: the one place, with the codecs, that knows logs and logits."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.optimize.adam import NAMES, Activated, Group, Inertia, adam
from dwgs.scene import Gaussians
from dwgs.splat import Splats

MAX_OPACITY = 1 - 1e-5
"""Beyond it the logit saturates in float32."""


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Step sizes of Adam for each group of parameters."""

    means: float
    """[m], times the scale of each Gaussian's own steps."""
    quats: float
    scales: float
    """On the logarithm."""
    opacities: float
    """On the logit."""
    sh_dc: float
    sh_rest: float
    betas: tuple[float, float] = (0.9, 0.99)
    amplified: tuple[str, ...] = ()
    """Groups whose gradients' trend is amplified: they go far where all views agree, and overshoot where they start far
    off."""
    stillness: float = 0.0
    """Gradients below this share of their group's root mean square move their parameter in proportion. Adam alone
    makes full steps of any gradient, so that what hardly shows wanders."""


class SplatParameters:
    """Gaussians as an optimiser wants them: unbounded, each group with its own rate, growing and shrinking.

    `splats` gives activated leaves; what a loss leaves as their gradients `step` carries to the parameters
    themselves, through the activations' derivatives, in one pass of Adam over memory.

    Args:
        gaussians: Where they begin.
        rates: How far they step.
        mean_step_scale: [N] means move in units of this: to move as many pixels, a far Gaussian takes longer steps.
        bounds: [2, 3] lowest and highest place of a centre [m].
        max_scales: [3] largest standard deviations [m].
        device: Where they live; on a GPU a step can be captured in a graph.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        rates: Rates,
        mean_step_scale: Tensor | None = None,
        bounds: NDArray | None = None,
        max_scales: Sequence[float] | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.rates, self._device = rates, torch.device(device)
        unbounded = np.array([[-np.inf] * 3, [np.inf] * 3])
        limits = torch.from_numpy(np.float32(unbounded if bounds is None else bounds)).to(device)
        most = torch.tensor([torch.inf] * 3 if max_scales is None else max_scales, device=device)
        self._limits = dict(zip(("lows", "highs", "log_most"), (*limits, most.log()), strict=True))
        self._clock = torch.zeros(4, device=device)  # see `Adam`: on a GPU, where a graph reads it
        raw = self._raw_from(gaussians, mean_step_scale)
        kept = {name: 2 + (name in rates.amplified) for name in NAMES}
        self._install(raw, {name: [torch.zeros_like(raw[name]) for _ in range(kept[name])] for name in NAMES})

    def __len__(self) -> int:
        return len(self._raw["opacities"])

    def splats(self) -> Splats:
        """The activated Gaussians; a gradient flows to them, until the next `step`."""
        return self._splats

    def step(self, factor: float | Tensor = 1.0) -> None:
        """One step of Adam along the gradients, rates times ``factor``; the gradients are used up.

        In a captured graph a ``factor`` that is a tensor [] can change from replay to replay.
        """
        self._follow(_used_up(self._splats), factor)

    def append(self, gaussians: Gaussians, mean_step_scale: Tensor | None = None) -> None:
        """Add Gaussians; the optimiser knows nothing of them yet and keeps what it knows of the others."""
        fresh = self._raw_from(gaussians, mean_step_scale)
        raw = {name: torch.cat([self._raw[name], fresh[name]]) for name in fresh}
        nothing = {name: torch.zeros_like(fresh[name]) for name in NAMES}
        self._install(raw, {name: [torch.cat([m, nothing[name]]) for m in self._moments[name]] for name in NAMES})

    def keep(self, mask: Tensor) -> None:
        """Keep only the Gaussians where ``mask`` [N] is True."""
        moments = {name: [moment[mask] for moment in self._moments[name]] for name in NAMES}
        self._install({name: values[mask] for name, values in self._raw.items()}, moments)

    def confine(self, rows: slice, bounds: Tensor, max_scale: float) -> None:
        """Put the means of some into ``bounds`` [2, 3] (lowest, highest) [m], their scales below ``max_scale`` [m]."""
        origins, means, strides = (self._raw[name][rows] for name in ("origins", "means", "strides"))
        low, high = ((bound - origins) / strides for bound in bounds)
        means.copy_(torch.minimum(torch.maximum(means, low), high))
        self._raw["scales"][rows].clamp_(max=math.log(max_scale))
        with torch.no_grad():
            self._own.means[rows] = origins + strides * means
            self._own.scales[rows] = self._raw["scales"][rows].exp()

    def to_gaussians(self) -> Gaussians:
        """A detached copy, activated."""
        return self._own.to_gaussians()

    def flat(self) -> Tensor:
        """A detached copy of all parameters in one vector: what an average over steps is taken of."""
        return torch.cat([self._raw[name].reshape(-1) for name in NAMES])

    def load_flat(self, flat: Tensor) -> None:
        """Put back what `flat` gave."""
        sizes = [self._raw[name].numel() for name in NAMES]
        for name, part in zip(NAMES, flat.split(sizes), strict=True):
            self._raw[name].copy_(part.view_as(self._raw[name]))
        self._place(self._splats, self._begin)

    def state_dict(self) -> dict[str, Any]:
        """Everything that further steps depend on."""
        return {"raw": self._raw, "moments": self._moments, "clock": self._clock, "adam": self._adam.state()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Be what `state_dict` gave, however many Gaussians that are; those of `Together` stay as many."""
        if len(state["raw"]["opacities"]) != len(self):
            self._install(dict(state["raw"]), dict(state["moments"]))
        for name in self._raw:
            self._raw[name].copy_(state["raw"][name])
        for name in NAMES:
            for moment, saved in zip(self._moments[name], state["moments"][name], strict=True):
                moment.copy_(saved)
        self._clock.copy_(state["clock"])
        self._place(self._splats, self._begin)
        self._adam.load_state(state["adam"])

    def _follow(self, gradients: dict[str, Tensor], factor: float | Tensor) -> None:
        """Step along the gradients by these Gaussians."""
        if gradients:
            self._clock[1].fill_(factor)
            self._adam.step(gradients, self._clock)

    def _raw_from(self, gaussians: Gaussians, mean_step_scale: Tensor | None) -> dict[str, Tensor]:
        means, quats, scales, opacities, sh = (
            torch.from_numpy(x.copy()).to(self._device)
            for x in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
        )
        step_scales = torch.ones_like(opacities) if mean_step_scale is None else mean_step_scale.to(self._device)
        return {
            "origins": means,
            "means": torch.zeros_like(means),
            "strides": step_scales[:, None].expand(-1, 3).contiguous(),
            "quats": quats,
            "scales": scales.log(),
            "opacities": opacities.clamp(1 - MAX_OPACITY, MAX_OPACITY).logit(),
            "sh": sh,
        }

    def _install(self, raw: dict[str, Tensor], moments: dict[str, list[Tensor]]) -> None:
        self._raw, self._moments = raw, moments
        leaves = [torch.empty_like(raw["means"]), raw["quats"], torch.empty_like(raw["scales"])]
        leaves += [torch.empty_like(raw["opacities"]), raw["sh"]]
        self._place(Splats(*(leaf.requires_grad_() for leaf in leaves)), 0)

    def _place(self, splats: Splats, begin: int) -> None:
        """From now on be the Gaussians [begin, begin + N) of these."""
        self._splats, self._begin = splats, begin
        own = {name: getattr(splats, name).detach()[begin : begin + len(self)] for name in NAMES}
        self._own = Splats(**own)
        for name in ("quats", "sh"):  # which are their own parameters
            own[name].copy_(self._raw[name].detach())
            self._raw[name] = own[name]
        raw, sh_period = self._raw, 3 * self._raw["sh"].shape[1]
        opacity_derivative = torch.empty_like(raw["opacities"])
        derivatives = {"means": raw["strides"], "scales": own["scales"], "opacities": opacity_derivative}
        groups = {
            name: Group(
                raw[name],
                self._moments[name],
                derivatives.get(name),
                (self.rates.sh_dc, self.rates.sh_rest) if name == "sh" else (getattr(self.rates, name), 0.0),
                sh_period if name == "sh" else 1,
            )
            for name in NAMES
        }
        activated = Activated(
            raw["origins"],
            raw["strides"],
            own["means"],
            own["scales"],
            own["opacities"],
            opacity_derivative,
            **self._limits,
        )
        inertia = Inertia(self.rates.betas, self.rates.stillness)
        self._adam = adam(groups, activated, inertia)


class Together:
    """Several parameters as one cloud, which one rendering shows; from now on they step together.

    Their spherical harmonics have one degree.
    """

    def __init__(self, parts: Sequence[SplatParameters]) -> None:
        self._parts, self._bounds = parts, [0, *accumulate(map(len, parts))]
        self._splats = Splats.cat([part.splats() for part in parts])
        self._splats = Splats(*(getattr(self._splats, name).detach().requires_grad_() for name in NAMES))
        for part, begin in zip(parts, self._bounds, strict=False):
            part._place(self._splats, begin)

    def splats(self) -> Splats:
        """The activated Gaussians, those of the first part first; a gradient flows to them, until the next `step`."""
        return self._splats

    def step(self, factor: float) -> None:
        """One step of every part, see `SplatParameters.step`."""
        gradients = _used_up(self._splats)
        for part, begin, end in zip(self._parts, self._bounds, self._bounds[1:], strict=False):
            part._follow({name: gradient[begin:end] for name, gradient in gradients.items()}, factor)


def _used_up(splats: Splats) -> dict[str, Tensor]:
    """The gradients that a loss left, which are gone after this."""
    leaves = {name: getattr(splats, name) for name in NAMES}
    gradients = {name: leaf.grad.contiguous() for name, leaf in leaves.items() if leaf.grad is not None}
    for leaf in leaves.values():
        leaf.grad = None
    return gradients


class PoseParameters:
    """A small rigid correction for each of ``count`` poses, about the pose's own origin."""

    def __init__(self, count: int, rotation_rate: float, translation_rate: float, device: str = "cpu") -> None:
        self.rotations = torch.zeros(count, 3, device=device, requires_grad=True)
        """[count, 3] rotation vectors [rad]."""
        self.translations = torch.zeros(count, 3, device=device, requires_grad=True)
        """[count, 3] [m]."""
        groups = [
            {"params": [self.rotations], "rate": rotation_rate},
            {"params": [self.translations], "rate": translation_rate},
        ]
        self._optimizer = torch.optim.Adam(groups, lr=1.0, betas=(0.9, 0.99), eps=1e-15)

    def matrix(self, i: int) -> Tensor:
        """Differentiable ``old_from_new`` [4, 4] of pose ``i``: ``a_from_new = a_from_old @ old_from_new``."""
        return self.matrices([i])[0]

    def matrices(self, index: Sequence[int]) -> Tensor:
        """Those [P, 4, 4] of the poses named."""
        rotations, translations = self.rotations[index], self.translations[index]
        x, y, z = rotations.unbind(1)
        zero = torch.zeros_like(x)
        skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(-1, 3, 3)
        upper = torch.cat([torch.matrix_exp(skew), translations[:, :, None]], 2)
        last = upper.new_tensor([[[0, 0, 0, 1]]]).expand(len(upper), -1, -1)
        return torch.cat([upper, last], 1)

    def step(self, factor: float = 1.0) -> None:
        """One step of Adam along the gradients, rates times ``factor``; the gradients are used up."""
        for group in self._optimizer.param_groups:
            group["lr"] = group["rate"] * factor
        self._optimizer.step()
        self._optimizer.zero_grad(set_to_none=True)

    def state_dict(self) -> dict[str, Any]:
        """Everything that further steps depend on."""
        return {
            "rotations": self.rotations.detach(),
            "translations": self.translations.detach(),
            "optimizer": self._optimizer.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Be what `state_dict` gave."""
        with torch.no_grad():
            self.rotations.copy_(state["rotations"])
            self.translations.copy_(state["translations"])
        self._optimizer.load_state_dict(dict(state["optimizer"]))
