"""Adam on the parameters of Gaussians, and the Gaussians it leads to: everything but the gradients stays in place."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
import warp as wp
from torch import Tensor

from dwgs.optimize.kernels import activation, adam_cpu, adam_cuda
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import even, launch

EPSILON = 1e-15
"""Adam's, where nothing shall be still."""
THREADS, WORTH_A_THREAD = 2, 8
"""How many share a step on a CPU, and tasks that take longer than to hand them over."""


@dataclass(frozen=True)
class Group:
    """Parameters, what the optimiser knows of them, and how far they step."""

    raw: Tensor
    moments: list[Tensor]
    """Running means of the gradient and of its square."""
    derivative: Tensor | None
    """Of the activated by the raw parameters; read at every step. None: 1."""
    rates: tuple[float, float]
    """Of every ``period`` numbers the first three step at the first, the rest at the second."""
    period: int


_ROUNDS = adam_cpu.LANES // 3 + 2
NAMES = ("means", "quats", "scales", "opacities", "sh")
"""Of the groups."""


@dataclass(frozen=True)
class Activated:
    """Gaussians whose parameters are optimised; what bounds them and how they follow. Tensors [N, ...]."""

    origins: Tensor
    """Where the means began [m]."""
    strides: Tensor
    """[N, 3] how far a mean goes with its parameter [m]."""
    means: Tensor
    scales: Tensor
    scale_derivative: Tensor
    opacities: Tensor
    opacity_derivative: Tensor
    lows: Tensor
    """[3] bounds of the means [m]."""
    highs: Tensor
    """[3]."""
    most: Tensor
    """[3] those of the scales [m]."""

    def activate(self, groups: Mapping[str, Group]) -> Any:
        """Make them what their parameters say; for the kernels, the same."""
        to = activation.Activation()
        for name, tensor in vars(self).items():
            goes_round = name in ("lows", "highs", "most")
            setattr(to, name, wp.from_torch(tensor.repeat(_ROUNDS) if goes_round else tensor.view(-1)))
        raw = [wp.from_torch(groups[name].raw.view(-1)) for name in ("means", "scales", "opacities")]
        size = 1 if self.means.is_cuda else adam_cpu.SPAN
        device = wp.device_from_torch(self.means.device)
        with torch_stream(self.means.device):
            launch(activation.activate, [0, -(-len(self.means) // size)], [size, *raw, to], device, 1)
        return to


class Adam(Protocol):
    """Steps of groups by name."""

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor, betas: tuple[float, float], still: float) -> None:
        """Carry gradients by the activated parameters to the parameters.

        ``clock`` [4], where they are, counts the steps and holds a factor on the rates. Gradients below a share
        ``still`` of their group's root mean square move their parameter in proportion.
        """
        ...


def adam(groups: Mapping[str, Group], activated: Activated) -> Adam:
    """On a CPU or on a GPU, wherever they are; the Gaussians are those of the parameters from now on."""
    return (_OnCuda if activated.means.is_cuda else _OnCpu)(groups, activated)


class _OnCpu:
    def __init__(self, groups: Mapping[str, Group], activated: Activated) -> None:
        self._to = activated.activate(groups)
        self._groups = {name: _CpuGroup(groups[name]) for name in NAMES}
        self._sums = np.zeros((-(-len(activated.means) // adam_cpu.SPAN), len(NAMES), 2), np.float32)
        self._out = wp.array(self._sums, dtype=wp.vec2, device="cpu", copy=False)

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor, betas: tuple[float, float], still: float) -> None:
        clock[0] += 1
        steps, factor, *_ = clock.tolist()
        unbiased = 1 / (1 - betas[0] ** steps), (1 - betas[1] ** steps) ** -0.5
        inputs = [group.prepare(gradients.get(name), factor, still) for name, group in self._groups.items()]
        bounds = even(len(self._sums), WORTH_A_THREAD, THREADS)
        device = wp.get_device("cpu")
        launch(adam_cpu.adam, bounds, [*inputs, *betas, *unbiased, self._to, self._out], device, THREADS)
        for name, sums in zip(NAMES, self._sums.sum(0, dtype=np.float64), strict=True):
            if name in gradients:
                self._groups[name].mean_squares = sums / self._groups[name].sizes


class _CpuGroup:
    def __init__(self, group: Group) -> None:
        raw, period = group.raw, group.period
        self._is_rest = (np.arange(period + adam_cpu.LANES) % period >= 3).astype(np.float32)
        self._base = np.where(self._is_rest > 0, group.rates[1], group.rates[0]).astype(np.float32)
        self._rates, self._stills = self._base.copy(), np.zeros_like(self._base)
        is_rest = self._is_rest[:period] > 0
        by_place = group.moments[1].reshape(-1, period).double().sum(0).numpy()
        classes = ~is_rest, is_rest
        self.sizes = np.array([max(raw.numel() // period * place.sum(), 1) for place in classes])
        self.mean_squares = np.array([by_place[place].sum() for place in classes]) / self.sizes
        self._group = _fill(adam_cpu.Group(), group)
        for key, pattern in {"rates": self._rates, "stills": self._stills, "is_rest": self._is_rest}.items():
            setattr(self._group, key, wp.array(pattern, dtype=float, device="cpu", copy=False))

    def prepare(self, gradient: Tensor | None, factor: float, still: float) -> Any:
        """The same for the kernel, to step along a gradient."""
        usual, rest = np.maximum(still * np.sqrt(self.mean_squares), EPSILON)
        np.multiply(self._base, factor, out=self._rates)
        self._stills[:] = np.where(self._is_rest > 0, rest, usual)
        self._group.gradient = None if gradient is None else wp.from_torch(gradient.view(-1))
        return self._group


class _OnCuda:
    def __init__(self, groups: Mapping[str, Group], activated: Activated) -> None:
        self._to = activated.activate(groups)
        self._variances = [groups[name].moments[1].view(-1, groups[name].period) for name in NAMES]
        self._groups = {name: _fill(adam_cuda.Group(), groups[name]) for name in NAMES}
        for name, group in self._groups.items():
            group.rate, group.rest_rate = groups[name].rates
        self._stills = torch.full((len(NAMES), 2), EPSILON, device=activated.means.device)

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor, betas: tuple[float, float], still: float) -> None:
        if still:
            for stills, variance in zip(self._stills, self._variances, strict=True):
                for k, part in enumerate((variance[:, :3], variance[:, 3:])):
                    if part.numel():
                        stills[k].copy_((still * part.mean().sqrt()).clamp_min(EPSILON))
        for name, group in self._groups.items():
            group.gradient = wp.from_torch(gradients[name].view(-1)) if name in gradients else None
        count = sum(gradient.numel() for gradient in gradients.values())
        in_clock, device = wp.from_torch(clock), wp.device_from_torch(clock.device)
        inputs = [*self._groups.values(), in_clock, wp.from_torch(self._stills), *betas, self._to]
        with torch_stream(clock.device):
            wp.launch(adam_cuda.tick, 1, [in_clock, *betas], device=device, record_tape=False)
            wp.launch(adam_cuda.adam, count, inputs, device=device, record_tape=False)


def _fill(struct: Any, group: Group) -> Any:
    """What both kernels take."""
    tensors = {"raw": group.raw, "moment": group.moments[0], "variance": group.moments[1]}
    if group.derivative is not None:
        tensors["derivative"] = group.derivative
    for key, tensor in tensors.items():
        setattr(struct, key, wp.from_torch(tensor.view(-1)))
    struct.period = group.period
    return struct
