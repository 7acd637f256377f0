"""Trainable parameters: the one place, with the codecs, that knows logs and logits."""

from dataclasses import dataclass

import torch
from torch import Tensor

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
    stillness: float = 0.0
    """Gradients below this share of their group's root mean square move their parameter in proportion. Adam alone
    makes full steps of any gradient, so that what hardly shows wanders."""


class SplatParameters:
    """Gaussians as an optimiser wants them: unbounded, each group with its own rate, growing and shrinking.

    Means move in units of ``mean_step_scale`` [N]: to move as many pixels, a far Gaussian takes longer steps.
    """

    def __init__(
        self, gaussians: Gaussians, rates: Rates, mean_step_scale: Tensor | None = None, device: str = "cpu"
    ) -> None:
        self.rates = rates
        self.device = device
        self._raw: dict[str, Tensor] = {}
        self._install(self._raw_from(gaussians, mean_step_scale), {})

    def __len__(self) -> int:
        return len(self._raw["opacities"])

    def splats(self) -> Splats:
        """The activated Gaussians, differentiable."""
        raw = self._raw
        return Splats(
            raw["origins"] + raw["means"] * raw["step_scales"],
            raw["quats"],
            raw["scales"].exp(),
            raw["opacities"].sigmoid(),
            torch.cat([raw["sh_dc"], raw["sh_rest"]], 1) if raw["sh_rest"].shape[1] else raw["sh_dc"],
        )

    def step(self, factor: float = 1.0) -> None:
        """One step of Adam along the gradients, rates times ``factor``; the gradients are used up."""
        for group in self._optimizer.param_groups:
            group["lr"] = group["rate"] * factor
            moments = self._optimizer.state.get(group["params"][0])
            if moments and self.rates.stillness > 0 and moments["exp_avg_sq"].numel():
                group["eps"] = self.rates.stillness * moments["exp_avg_sq"].mean().sqrt().item()
        self._optimizer.step()
        self._optimizer.zero_grad(set_to_none=True)

    def append(self, gaussians: Gaussians, mean_step_scale: Tensor | None = None) -> None:
        """Add Gaussians; the optimiser knows nothing of them yet and keeps what it knows of the others."""
        fresh = self._raw_from(gaussians, mean_step_scale)
        raw = {name: torch.cat([self._raw[name].detach(), fresh[name]]) for name in fresh}
        state = self._state()
        for name in state:
            for moment in ("exp_avg", "exp_avg_sq"):
                state[name][moment] = torch.cat([state[name][moment], torch.zeros_like(fresh[name])])
        self._install(raw, state)

    def keep(self, mask: Tensor) -> None:
        """Keep only the Gaussians where ``mask`` [N] is True."""
        state = self._state()
        for name in state:
            for moment in ("exp_avg", "exp_avg_sq"):
                state[name][moment] = state[name][moment][mask]
        self._install({name: values.detach()[mask] for name, values in self._raw.items()}, state)

    def to_gaussians(self) -> Gaussians:
        """A detached copy, activated."""
        return self.splats().to_gaussians()

    def flat(self) -> Tensor:
        """A detached copy of all parameters in one vector: what an average over steps is taken of."""
        return torch.cat([self._raw[name].detach().reshape(-1) for name in self._trainable])

    def load_flat(self, flat: Tensor) -> None:
        """Put back what `flat` gave."""
        with torch.no_grad():
            start = 0
            for name in self._trainable:
                values = self._raw[name]
                values.copy_(flat[start : start + values.numel()].view_as(values))
                start += values.numel()

    _trainable = ("means", "quats", "scales", "opacities", "sh_dc", "sh_rest")

    def _raw_from(self, gaussians: Gaussians, mean_step_scale: Tensor | None) -> dict[str, Tensor]:
        means, quats, scales, opacities, sh = (
            torch.from_numpy(x.copy()).to(self.device)
            for x in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)
        )
        step_scales = torch.ones(len(means)) if mean_step_scale is None else mean_step_scale
        return {
            "origins": means,
            "means": torch.zeros_like(means),
            "step_scales": step_scales.to(means)[:, None],
            "quats": quats,
            "scales": scales.log(),
            "opacities": opacities.clamp(1 - MAX_OPACITY, MAX_OPACITY).logit(),
            "sh_dc": sh[:, :1].contiguous(),
            "sh_rest": sh[:, 1:].contiguous(),
        }

    def _state(self) -> dict[str, dict]:
        return {
            name: dict(self._optimizer.state[self._raw[name]])
            for name in self._trainable
            if self._raw[name] in self._optimizer.state
        }

    def _install(self, raw: dict[str, Tensor], state: dict[str, dict]) -> None:
        self._raw = raw
        for name in self._trainable:
            raw[name].requires_grad_(True)
        groups = [{"params": [raw[name]], "rate": getattr(self.rates, name)} for name in self._trainable]
        self._optimizer = torch.optim.Adam(groups, lr=1.0, betas=self.rates.betas, eps=1e-15, fused=True)
        for name, moments in state.items():
            self._optimizer.state[raw[name]] = moments


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
