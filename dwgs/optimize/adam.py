"""Adam on the parameters of Gaussians, and the Gaussians it leads to: everything but the gradients stays in place."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
import warp as wp
from torch import Tensor

from dwgs.optimize.kernels import activation, adam_cpu, adam_cuda
from dwgs.splat import crew
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import launch

EPSILON = 1e-15
"""Adam's, where nothing shall be still."""
TREND_BETA, TREND_WEIGHT = 0.99, 1.5
"""Of a running mean of a hundred gradients, which is added to each (Grokfast, Lee et al. 2024): one view at a time says
little of what all of them want."""
THREADS, WORTH_A_THREAD = 2, 8
"""How many share a step on a CPU, and spans that take longer than to hand them over."""


@dataclass(frozen=True)
class Group:
    """Parameters, what the optimiser knows of them, and how far they step."""

    raw: Tensor
    moments: list[Tensor]
    """Running means of the gradient and of its square, and its trend, if this is amplified."""
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
    opacities: Tensor
    opacity_derivative: Tensor
    lows: Tensor
    """[3] bounds of the means [m]."""
    highs: Tensor
    """[3]."""
    log_most: Tensor
    """[3] those of the logarithm of the scales."""

    def activate(self, groups: Mapping[str, Group]) -> Any:
        """Make them what their parameters say; for the kernels, the same."""
        to = activation.Activation()
        for name, tensor in vars(self).items():
            goes_round = name in ("lows", "highs", "log_most")
            setattr(to, name, wp.from_torch(tensor.repeat(_ROUNDS) if goes_round else tensor.view(-1)))
        raw = [wp.from_torch(groups[name].raw.view(-1)) for name in ("means", "scales", "opacities")]
        size = 1 if self.means.is_cuda else adam_cpu.SPAN
        device = wp.device_from_torch(self.means.device)
        with torch_stream(self.means.device):
            launch(activation.activate, [0, -(-len(self.means) // size)], [size, *raw, to], device, 1)
        return to


class Adam(Protocol):
    """Steps of groups by name."""

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor) -> None:
        """Carry gradients by the activated parameters to the parameters.

        ``clock`` [4], where they are, counts the steps and holds a factor on the rates.
        """
        ...

    def state(self) -> list[list[float]]:
        """What it knows beside the groups' moments."""
        ...

    def load_state(self, state: list[list[float]]) -> None:
        """Know what `state` gave."""
        ...


@dataclass(frozen=True)
class Inertia:
    """How gradients move parameters."""

    betas: tuple[float, float]
    """Of Adam's running means."""
    still: float
    """Gradients below this share of their group's root mean square move their parameter in proportion."""


def adam(groups: Mapping[str, Group], activated: Activated, inertia: Inertia) -> Adam:
    """On a CPU or on a GPU, wherever they are; the Gaussians are those of the parameters from now on."""
    return (_OnCuda if activated.means.is_cuda else _OnCpu)(groups, activated, inertia)


class _OnCpu:
    def __init__(self, groups: Mapping[str, Group], activated: Activated, inertia: Inertia) -> None:
        self._to, self._inertia = activated.activate(groups), inertia
        self._groups = [_fill(adam_cpu.Group(), groups[name]) for name in NAMES]
        for group in self._groups:
            pattern = (np.arange(group.period + adam_cpu.LANES) % group.period >= 3).astype(np.float32)
            group.is_rest = wp.array(pattern, dtype=float, device="cpu")
        self._rates = np.array([groups[name].rates for name in NAMES])
        count, periods = len(activated.means), [groups[name].period for name in NAMES]
        per_gaussian = np.array([groups[name].raw.numel() // max(count, 1) for name in NAMES])
        is_whole = np.array([period == 1 for period in periods])
        usual = np.where(is_whole, per_gaussian, 3)
        self._sizes = np.maximum(count * np.stack([usual, per_gaussian - usual], 1), 1)
        self._mean_squares = np.array([_sums_of(groups[name]) for name in NAMES]) / self._sizes
        self._sums = np.zeros((-(-count // adam_cpu.SPAN), len(NAMES), 2), np.float32)
        self._numbers = np.zeros((len(NAMES), 6), np.float32)
        self._gradients: list[Tensor | None] = []
        self._run: Any = None

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor) -> None:
        clock[0] += 1
        steps, factor, *_ = clock.tolist()
        self._numbers[:, :2] = factor * self._rates
        self._numbers[:, 2:4] = np.maximum(self._inertia.still * np.sqrt(self._mean_squares), EPSILON)
        beta1, beta2 = self._inertia.betas
        self._numbers[:, 4:] = 1 / (1 - beta1**steps), (1 - beta2**steps) ** -0.5
        in_order = [gradients.get(name) for name in NAMES]
        if not _are_same(in_order, self._gradients):
            self._pack(in_order)
        self._run()
        is_known = [name in gradients for name in NAMES]
        sums = self._sums.sum(0, dtype=np.float64) / self._sizes
        self._mean_squares[is_known] = sums[is_known]

    def state(self) -> list[list[float]]:
        return self._mean_squares.tolist()

    def load_state(self, state: list[list[float]]) -> None:
        self._mean_squares[:] = state

    def _pack(self, gradients: list[Tensor | None]) -> None:
        self._gradients = gradients
        for group, gradient in zip(self._groups, gradients, strict=True):
            group.gradient = None if gradient is None else wp.from_torch(gradient.view(-1))
        numbers = wp.array(self._numbers, dtype=adam_cpu.vec6, device="cpu", copy=False)
        out = wp.array(self._sums, dtype=wp.vec2, device="cpu", copy=False)
        threads = THREADS if len(self._sums) >= WORTH_A_THREAD else 1
        inertia = *self._inertia.betas, TREND_BETA, TREND_WEIGHT
        self._run = crew.pack(adam_cpu.adam, [*self._groups, numbers, *inertia, self._to, out], threads)


def _sums_of(group: Group) -> tuple[float, float]:
    """Of the running mean squares, those of the first three of a period and those of the rest."""
    by_place = group.moments[1].reshape(-1, group.period).double().sum(0)
    return by_place[:3].sum().item(), by_place[3:].sum().item()


def _are_same(these: list[Tensor | None], those: list[Tensor | None]) -> bool:
    """Whether they lie in the same memory."""

    def place(tensor: Tensor | None) -> tuple[int, int]:
        return (0, 0) if tensor is None else (tensor.data_ptr(), tensor.numel())

    return [place(tensor) for tensor in these] == [place(tensor) for tensor in those]


class _OnCuda:
    def __init__(self, groups: Mapping[str, Group], activated: Activated, inertia: Inertia) -> None:
        self._to, self._inertia = activated.activate(groups), inertia
        self._variances = [groups[name].moments[1].view(-1, groups[name].period) for name in NAMES]
        self._groups = {name: _fill(adam_cuda.Group(), groups[name]) for name in NAMES}
        for name, group in self._groups.items():
            group.rate, group.rest_rate = groups[name].rates
        self._stills = torch.full((len(NAMES), 2), EPSILON, device=activated.means.device)

    def step(self, gradients: Mapping[str, Tensor], clock: Tensor) -> None:
        betas, still = self._inertia.betas, self._inertia.still
        if still:
            for stills, variance in zip(self._stills, self._variances, strict=True):
                for k, part in enumerate((variance[:, :3], variance[:, 3:])):
                    if part.numel():
                        stills[k].copy_((still * part.mean().sqrt()).clamp_min(EPSILON))
        for name, group in self._groups.items():
            group.gradient = wp.from_torch(gradients[name].view(-1)) if name in gradients else None
        count = sum(gradient.numel() for gradient in gradients.values())
        in_clock, device = wp.from_torch(clock), wp.device_from_torch(clock.device)
        inertia = *betas, TREND_BETA, TREND_WEIGHT
        inputs = [*self._groups.values(), in_clock, wp.from_torch(self._stills), *inertia, self._to]
        with torch_stream(clock.device):
            wp.launch(adam_cuda.tick, 1, [in_clock, *betas], device=device, record_tape=False)
            wp.launch(adam_cuda.adam, count, inputs, device=device, record_tape=False)

    def state(self) -> list[list[float]]:
        return []  # it finds out anew at every step

    def load_state(self, state: list[list[float]]) -> None:
        pass


def _fill(struct: Any, group: Group) -> Any:
    """What both kernels take."""
    tensors = {"raw": group.raw, "moment": group.moments[0], "variance": group.moments[1]}
    if len(group.moments) > 2:
        tensors["trend"] = group.moments[2]
    if group.derivative is not None:
        tensors["derivative"] = group.derivative
    for key, tensor in tensors.items():
        setattr(struct, key, wp.from_torch(tensor.view(-1)))
    struct.period = group.period
    return struct
