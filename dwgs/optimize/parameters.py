"""Trainable parameters: the one place, with the codecs, that knows logs and logits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from torch import Tensor

from dwgs.optimize import kernels
from dwgs.scene import Gaussians
from dwgs.splat import Splats
from dwgs.splat.parallel import even, launch

MAX_OPACITY = 1 - 1e-5
"""Beyond it the logit saturates in float32."""
EPSILON = 1e-15
"""Adam's, where nothing shall be still."""
THREADS, WORTH_A_THREAD = 2, 8
"""How many share a step, and tasks that take longer than to hand them over."""


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
        bounds: [2, 3] lowest and highest place of a centre [m]; what has left it can find back.
        max_scales: [3] largest standard deviations [m].
    """

    def __init__(
        self,
        gaussians: Gaussians,
        rates: Rates,
        mean_step_scale: Tensor | None = None,
        bounds: NDArray | None = None,
        max_scales: Sequence[float] | None = None,
    ) -> None:
        self.rates = rates
        self._low, self._high = (None, None) if bounds is None else torch.from_numpy(np.float32(bounds)).unbind(0)
        self._max_scales = None if max_scales is None else torch.tensor(max_scales)
        self._steps = 0
        raw = self._raw_from(gaussians, mean_step_scale)
        self._install(raw, {name: [torch.zeros_like(raw[name]) for _ in range(2)] for name in _GROUPS})

    def __len__(self) -> int:
        return len(self._raw["opacities"])

    def splats(self) -> Splats:
        """The activated Gaussians; a gradient flows to them, until the next `step`."""
        if self._splats is None:
            raw = self._raw
            means = torch.addcmul(raw["origins"], raw["means"], raw["step_scales"])
            scales, opacities = raw["scales"].exp(), raw["opacities"].sigmoid()
            if self._low is not None:
                means = means.clamp_(self._low, self._high)
            if self._max_scales is not None:
                scales = torch.minimum(scales, self._max_scales, out=scales)
            leaves = (means, raw["quats"], scales, opacities, raw["sh"])
            self._splats = Splats(*(leaf.detach().requires_grad_() for leaf in leaves))
        return self._splats

    def step(self, factor: float = 1.0) -> None:
        """One step of Adam along the gradients, rates times ``factor``; the gradients are used up."""
        if self._splats is None:
            return
        self._steps += 1
        beta1, beta2 = self.rates.betas
        numbers = [beta1, beta2, 1 / (1 - beta1**self._steps), (1 - beta2**self._steps) ** -0.5]
        opacities = self._splats.opacities.detach()
        derivatives = {
            "means": self._raw["mean_derivative"],
            "scales": self._splats.scales.detach(),
            "opacities": opacities * (1 - opacities),
        }
        for name in _GROUPS:
            gradient = getattr(self._splats, name).grad
            if gradient is not None and gradient.numel():
                self._step_group(name, gradient.contiguous(), derivatives.get(name), factor, numbers)
        self._splats = None

    def append(self, gaussians: Gaussians, mean_step_scale: Tensor | None = None) -> None:
        """Add Gaussians; the optimiser knows nothing of them yet and keeps what it knows of the others."""
        fresh = self._raw_from(gaussians, mean_step_scale)
        raw = {name: torch.cat([self._raw[name], fresh[name]]) for name in fresh}
        nothing = {name: torch.zeros_like(fresh[name]) for name in _GROUPS}
        self._install(raw, {name: [torch.cat([m, nothing[name]]) for m in self._moments[name]] for name in _GROUPS})

    def keep(self, mask: Tensor) -> None:
        """Keep only the Gaussians where ``mask`` [N] is True."""
        moments = {name: [moment[mask] for moment in self._moments[name]] for name in _GROUPS}
        self._install({name: values[mask] for name, values in self._raw.items()}, moments)

    def to_gaussians(self) -> Gaussians:
        """A detached copy, activated."""
        return self.splats().to_gaussians()

    def flat(self) -> Tensor:
        """A detached copy of all parameters in one vector: what an average over steps is taken of."""
        return torch.cat([self._raw[name].reshape(-1) for name in _GROUPS])

    def load_flat(self, flat: Tensor) -> None:
        """Put back what `flat` gave."""
        sizes = [self._raw[name].numel() for name in _GROUPS]
        for name, part in zip(_GROUPS, flat.split(sizes), strict=True):
            self._raw[name].copy_(part.view_as(self._raw[name]))
        self._splats = None

    def _raw_from(self, gaussians: Gaussians, mean_step_scale: Tensor | None) -> dict[str, Tensor]:
        means, quats, scales, opacities, sh = (
            torch.from_numpy(x.copy())
            for x in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
        )
        step_scales = torch.ones(len(means)) if mean_step_scale is None else mean_step_scale
        return {
            "origins": means,
            "means": torch.zeros_like(means),
            "step_scales": step_scales[:, None],
            "mean_derivative": step_scales[:, None].expand(-1, 3).contiguous(),
            "quats": quats,
            "scales": scales.log(),
            "opacities": opacities.clamp(1 - MAX_OPACITY, MAX_OPACITY).logit(),
            "sh": sh,
        }

    def _install(self, raw: dict[str, Tensor], moments: dict[str, list[Tensor]]) -> None:
        self._raw, self._moments = raw, moments
        self._splats: Splats | None = None
        self._is_rest = {name: torch.zeros(1) for name in _GROUPS}
        self._is_rest["sh"] = (torch.arange(3 * raw["sh"].shape[1]) >= 3).float()
        self._mean_squares = {name: self._class_means(name, moments[name][1]) for name in _GROUPS}

    def _class_means(self, name: str, variance: Tensor) -> Tensor:
        """[2] mean variance of a group, of what the pattern calls the rest apart."""
        is_rest = self._is_rest[name]
        by_place = variance.reshape(-1, len(is_rest)).double().sum(0)
        rest = (by_place * is_rest).sum()
        return torch.stack([by_place.sum() - rest, rest]) / self._class_sizes(name)

    def _class_sizes(self, name: str) -> Tensor:
        """[2] how many numbers of a group are of either class, at least 1."""
        count = self._raw[name].numel() // len(self._is_rest[name])
        rest = count * self._is_rest[name].sum()
        return torch.stack([self._raw[name].numel() - rest, rest]).clamp_min(1).double()

    def _step_group(
        self, name: str, gradient: Tensor, derivative: Tensor | None, factor: float, numbers: list[float]
    ) -> None:
        is_rest = self._is_rest[name]
        rates = (self.rates.sh_dc, self.rates.sh_rest) if name == "sh" else (getattr(self.rates, name),) * 2
        stills = (self.rates.stillness * self._mean_squares[name].sqrt()).clamp_min(EPSILON).tolist()
        group = kernels.Group()
        flat = {"raw": self._raw[name], "moment": self._moments[name][0], "variance": self._moments[name][1]}
        flat["derivative"] = gradient.new_zeros(0) if derivative is None else derivative
        for key, (usual, rest) in {"rates": rates, "stills": stills, "is_rest": (0.0, 1.0)}.items():
            scale = factor if key == "rates" else 1.0
            flat[key] = _repeated(scale * torch.where(is_rest > 0, rest, usual))
        for key, values in flat.items():
            setattr(group, key, wp.from_torch(values.reshape(-1)))
        group.period = len(is_rest)
        tasks = -(-gradient.numel() // kernels.SPAN)
        sums = torch.empty(tasks, 2)
        inputs = [group, wp.from_torch(gradient.view(-1)), *numbers, wp.from_torch(sums, dtype=wp.vec2)]
        launch(kernels.adam, even(tasks, WORTH_A_THREAD, THREADS), inputs, wp.get_device("cpu"), THREADS)
        self._mean_squares[name] = sums.double().sum(0) / self._class_sizes(name)


_GROUPS = ("means", "quats", "scales", "opacities", "sh")


def _repeated(pattern: Tensor) -> Tensor:
    """[period + LANES] a pattern [period] and its continuation."""
    times = -(-(len(pattern) + kernels.LANES) // len(pattern))
    return pattern.float().repeat(times)[: len(pattern) + kernels.LANES].contiguous()


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
        rotation, translation = self.rotations[i], self.translations[i]
        zero = rotation.new_zeros(())
        x, y, z = rotation
        skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
        upper = torch.cat([torch.matrix_exp(skew), translation[:, None]], 1)
        return torch.cat([upper, upper.new_tensor([[0, 0, 0, 1]])])

    def step(self, factor: float = 1.0) -> None:
        """One step of Adam along the gradients, rates times ``factor``; the gradients are used up."""
        for group in self._optimizer.param_groups:
            group["lr"] = group["rate"] * factor
        self._optimizer.step()
        self._optimizer.zero_grad(set_to_none=True)
