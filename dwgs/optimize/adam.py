"""Steps of Adam on one tensor of parameters, everything but the gradient staying in place."""

from typing import Any

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


class AdamGroup:
    """Of every ``period`` numbers the first three step at the first of ``rates``, the rest at the second.

    Args:
        raw: The parameters.
        moments: Running means of the gradient and of its square, shaped like them.
        derivative: Of the activated by the raw parameters, shaped like them too; read at every step. None: 1.
        rates: Step sizes.
        period: What the rates repeat with.
    """

    def __new__(cls, raw: Tensor, *_args: Any, **_kwargs: Any) -> "AdamGroup":
        """On a CPU or on a GPU, wherever ``raw`` is."""
        return super().__new__(_OnCuda if raw.is_cuda else _OnCpu)

    def __init__(
        self, raw: Tensor, moments: list[Tensor], derivative: Tensor | None, rates: tuple[float, float], period: int
    ) -> None:
        raise NotImplementedError

    def step(self, gradient: Tensor, clock: Tensor, betas: tuple[float, float], stillness: float) -> None:
        """Carry a gradient by the activated parameters to the parameters.

        ``clock`` [2], where they are, holds the number of this step and a factor on the rates.
        """
        raise NotImplementedError


class _OnCpu(AdamGroup):
    def __init__(
        self, raw: Tensor, moments: list[Tensor], derivative: Tensor | None, rates: tuple[float, float], period: int
    ) -> None:
        self._is_rest = (np.arange(period + adam_cpu.LANES) % period >= 3).astype(np.float32)
        self._base = np.where(self._is_rest > 0, rates[1], rates[0]).astype(np.float32)
        self._rates, self._stills = self._base.copy(), np.zeros_like(self._base)
        is_rest = self._is_rest[:period] > 0
        by_place = moments[1].reshape(-1, period).double().sum(0).numpy()
        classes = ~is_rest, is_rest
        self._sizes = np.array([max(raw.numel() // period * place.sum(), 1) for place in classes])
        self._mean_squares = np.array([by_place[place].sum() for place in classes]) / self._sizes
        self._sums = np.zeros((-(-raw.numel() // adam_cpu.SPAN), 2), np.float32)
        self._out = wp.array(self._sums, dtype=wp.vec2, device="cpu", copy=False)
        self._group = _fill(adam_cpu.Group(), raw, moments, derivative)
        for key, pattern in {"rates": self._rates, "stills": self._stills, "is_rest": self._is_rest}.items():
            setattr(self._group, key, wp.array(pattern, dtype=float, device="cpu", copy=False))
        self._group.period = period

    def step(self, gradient: Tensor, clock: Tensor, betas: tuple[float, float], stillness: float) -> None:
        steps, factor = clock.tolist()
        usual, rest = np.maximum(stillness * np.sqrt(self._mean_squares), EPSILON)
        np.multiply(self._base, factor, out=self._rates)
        self._stills[:] = np.where(self._is_rest > 0, rest, usual)
        unbiased = 1 / (1 - betas[0] ** steps), (1 - betas[1] ** steps) ** -0.5
        gradients = wp.from_torch(gradient.view(-1), return_ctype=True)
        bounds = even(len(self._sums), WORTH_A_THREAD, THREADS)
        inputs = [self._group, gradients, *betas, *unbiased, self._out]
        launch(adam_cpu.adam, bounds, inputs, wp.get_device("cpu"), THREADS)
        self._mean_squares = self._sums.sum(0, dtype=np.float64) / self._sizes


class _OnCuda(AdamGroup):
    def __init__(
        self, raw: Tensor, moments: list[Tensor], derivative: Tensor | None, rates: tuple[float, float], period: int
    ) -> None:
        self._variance = moments[1].view(-1, period)
        self._group = _fill(adam_cuda.Group(), raw, moments, derivative)
        self._group.rate, self._group.rest_rate = rates
        self._group.period = period
        self._stills = torch.full((2,), EPSILON, device=raw.device)

    def step(self, gradient: Tensor, clock: Tensor, betas: tuple[float, float], stillness: float) -> None:
        if stillness:
            for still, variances in zip(self._stills, (self._variance[:, :3], self._variance[:, 3:]), strict=True):
                if variances.numel():
                    still.copy_((stillness * variances.mean().sqrt()).clamp_min(EPSILON))
        arrays = [wp.from_torch(tensor) for tensor in (gradient.view(-1), clock, self._stills)]
        with torch_stream(gradient.device):
            device = wp.device_from_torch(gradient.device)
            wp.launch(adam_cuda.adam, gradient.numel(), [self._group, *arrays, *betas], device=device)


def _fill(group: Any, raw: Tensor, moments: list[Tensor], derivative: Tensor | None) -> Any:
    """The tensors, for either kernel."""
    derivative = raw.new_zeros(0) if derivative is None else derivative
    for key, tensor in {"raw": raw, "moment": moments[0], "variance": moments[1], "derivative": derivative}.items():
        setattr(group, key, wp.from_torch(tensor.view(-1)))
    return group
