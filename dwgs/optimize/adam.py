"""Adam on several tensors of parameters: everything but the gradients stays in place."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
import warp as wp
from torch import Tensor

from dwgs.optimize.kernels import adam_cpu, adam_cuda
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


class Adam(Protocol):
    """Steps of groups by name."""

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor, betas: tuple[float, float], still: float) -> None:
        """Carry gradients by the activated parameters to the parameters.

        ``clock`` [4], where they are, counts the steps and holds a factor on the rates. Gradients below a share
        ``still`` of their group's root mean square move their parameter in proportion.
        """
        ...


def adam(groups: Mapping[str, Group]) -> Adam:
    """On a CPU or on a GPU, wherever they are."""
    is_cuda = any(group.raw.is_cuda for group in groups.values())
    return _OnCuda(groups) if is_cuda else _OnCpu(groups)


class _OnCpu:
    def __init__(self, groups: Mapping[str, Group]) -> None:
        self._groups = {name: _CpuGroup(group) for name, group in groups.items()}

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor, betas: tuple[float, float], still: float) -> None:
        clock[0] += 1
        steps, factor, *_ = clock.tolist()
        unbiased = 1 / (1 - betas[0] ** steps), (1 - betas[1] ** steps) ** -0.5
        for name, gradient in gradients.items():
            self._groups[name].step(gradient, factor, [*betas, *unbiased], still)


class _CpuGroup:
    def __init__(self, group: Group) -> None:
        raw, period = group.raw, group.period
        self._is_rest = (np.arange(period + adam_cpu.LANES) % period >= 3).astype(np.float32)
        self._base = np.where(self._is_rest > 0, group.rates[1], group.rates[0]).astype(np.float32)
        self._rates, self._stills = self._base.copy(), np.zeros_like(self._base)
        is_rest = self._is_rest[:period] > 0
        by_place = group.moments[1].reshape(-1, period).double().sum(0).numpy()
        classes = ~is_rest, is_rest
        self._sizes = np.array([max(raw.numel() // period * place.sum(), 1) for place in classes])
        self._mean_squares = np.array([by_place[place].sum() for place in classes]) / self._sizes
        self._sums = np.zeros((-(-raw.numel() // adam_cpu.SPAN), 2), np.float32)
        self._out = wp.array(self._sums, dtype=wp.vec2, device="cpu", copy=False)
        self._group = _fill(adam_cpu.Group(), group)
        for key, pattern in {"rates": self._rates, "stills": self._stills, "is_rest": self._is_rest}.items():
            setattr(self._group, key, wp.array(pattern, dtype=float, device="cpu", copy=False))

    def step(self, gradient: Tensor, factor: float, numbers: list[float], still: float) -> None:
        usual, rest = np.maximum(still * np.sqrt(self._mean_squares), EPSILON)
        np.multiply(self._base, factor, out=self._rates)
        self._stills[:] = np.where(self._is_rest > 0, rest, usual)
        inputs = [self._group, wp.from_torch(gradient.view(-1), return_ctype=True), *numbers, self._out]
        bounds = even(len(self._sums), WORTH_A_THREAD, THREADS)
        launch(adam_cpu.adam, bounds, inputs, wp.get_device("cpu"), THREADS)
        self._mean_squares = self._sums.sum(0, dtype=np.float64) / self._sizes


class _OnCuda:
    def __init__(self, groups: Mapping[str, Group]) -> None:
        self._variances = [group.moments[1].view(-1, group.period) for group in groups.values()]
        self._groups = {name: _fill(adam_cuda.Group(), group) for name, group in groups.items()}
        for name, group in groups.items():
            self._groups[name].rate, self._groups[name].rest_rate = group.rates
        where = self._variances[0].device
        self._stills = torch.full((len(groups), 2), EPSILON, device=where)
        self._nothing = wp.zeros(0, dtype=float, device=wp.device_from_torch(where))

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor, betas: tuple[float, float], still: float) -> None:
        if still:
            for stills, variance in zip(self._stills, self._variances, strict=True):
                for k, part in enumerate((variance[:, :3], variance[:, 3:])):
                    if part.numel():
                        stills[k].copy_((still * part.mean().sqrt()).clamp_min(EPSILON))
        for name, group in self._groups.items():
            group.gradient = wp.from_torch(gradients[name].view(-1)) if name in gradients else self._nothing
        count = sum(gradient.numel() for gradient in gradients.values())
        in_clock, device = wp.from_torch(clock), wp.device_from_torch(clock.device)
        inputs = [*self._groups.values(), in_clock, wp.from_torch(self._stills), *betas]
        with torch_stream(clock.device):
            wp.launch(adam_cuda.tick, 1, [in_clock, *betas], device=device, record_tape=False)
            wp.launch(adam_cuda.adam, count, inputs, device=device, record_tape=False)


def _fill(struct: Any, group: Group) -> Any:
    """What both kernels take."""
    derivative = group.raw.new_zeros(0) if group.derivative is None else group.derivative
    tensors = {"raw": group.raw, "moment": group.moments[0], "variance": group.moments[1], "derivative": derivative}
    for key, tensor in tensors.items():
        setattr(struct, key, wp.from_torch(tensor.view(-1)))
    struct.period = group.period
    return struct
