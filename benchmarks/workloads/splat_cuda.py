"""The splatter's time and memory on a GPU, beside gsplat where that is installed.

Both are measured in turn, round by round, and a ratio is that of one round. A value is the median over the rounds, its
spread the interquartile range. What is timed is a row of steps, by events of the GPU, everything warm.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import fields
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from torch import Tensor

from benchmarks.metric import Metric
from dwgs.optimize import Rates, SplatParameters
from dwgs.optimize.losses import weighted_mse
from dwgs.splat import Splats, View, capture, composite, project, render

ROOM = 1.1
"""Capacity over the intersections there are."""
WARM_UP = 3
"""Steps before the first that counts."""
STEPS = 20
"""In a row."""
RATES = Rates(means=1e-4, quats=1e-4, scales=1e-4, opacities=1e-4, sh_dc=1e-4, sh_rest=1e-4)


RATIOS = {
    "speedup_over_gsplat": ("cuda.gsplat_step_ms", "cuda.step_ms"),
    "captured_over_gsplat": ("cuda.gsplat_train_ms", "cuda.captured_step_ms"),
}
"""One time over another: forward and adjoint, both eager; a step of training, ours in a graph."""


def measure(name: str, splats: Splats, view: View, repeats: int) -> list[Metric]:
    """Times, their ratios and the peak of memory of one scene."""
    splats = Splats(*(getattr(splats, f.name).cuda() for f in fields(Splats)))
    view = View(view.viewmat.cuda(), view.intrinsics, view.width, view.height)
    ours = OursOnCuda(splats, view)
    rival = _rival(splats, view)
    metrics = []
    if rival is not None:  # before either is trained
        error = (rival.render()[0] - ours.render()[0]).square().mean()
        metrics.append(Metric(f"splat.{name}.psnr_to_gsplat", -10 * error.log10().item(), "dB"))
    metrics += compare(name, {**ours.work(), **({} if rival is None else _work_of(rival, ours))}, repeats)
    torch.cuda.reset_peak_memory_stats()
    before = torch.cuda.memory_allocated()
    ours.step()
    peak = torch.cuda.max_memory_allocated() - before
    return [*metrics, Metric(f"splat.{name}.cuda.peak_bytes", peak, "B")]


def _rival(splats: Splats, view: View) -> Any:
    if find_spec("gsplat") is None:
        Console(stderr=True).print("gsplat is not installed: no rival on the GPU; pip install gsplat")
        return None
    from benchmarks.rivals.gsplat import Gsplat

    return Gsplat(splats, view)


def _work_of(rival: Any, ours: "OursOnCuda") -> dict[str, Callable[[], object]]:
    return {
        "cuda.gsplat_forward_ms": rival.render,
        "cuda.gsplat_step_ms": lambda: torch.autograd.grad(rival.render(), rival.inputs, ours.v_outputs),
        "cuda.gsplat_train_ms": lambda: rival.train(ours.target),
    }


def compare(name: str, work: dict[str, Callable[[], object]], repeats: int) -> list[Metric]:
    """Times and their ratios: median and spread."""
    samples: dict[str, list[float]] = defaultdict(list)
    for _ in range(WARM_UP):
        for each in work.values():
            each()
    for _ in track(range(repeats), f"{name} on the GPU", console=Console(stderr=True), transient=True):
        times = {key: milliseconds(each) for key, each in work.items()}
        ratios = {key: times[a] / times[b] for key, (a, b) in RATIOS.items() if a in times}
        for key, value in {**times, **ratios}.items():
            samples[key].append(value)
    metrics = []
    for key, values in samples.items():
        low, median, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
        metrics.append(Metric(f"splat.{name}.{key}", median, "" if key in RATIOS else "ms", high - low))
    return metrics


class OursOnCuda:
    """The splatter at work on one scene, never waited for."""

    def __init__(self, splats: Splats, view: View) -> None:
        self.splats, self.view = splats, view
        self.inputs = [getattr(splats, f.name).detach().clone().requires_grad_() for f in fields(Splats)]
        self.capacity = int(ROOM * int(render(splats, view).intersections))
        random = torch.Generator(view.viewmat.device).manual_seed(0)
        shape = view.height, view.width
        normal = lambda *shape: torch.randn(*shape, generator=random, device=random.device)  # noqa: E731
        self.v_outputs = normal(*shape, 3), normal(*shape), normal(*shape)
        self.target = normal(3, *shape).sigmoid().movedim(0, -1)  # planes, as renderings are

    def render(self) -> tuple[Tensor, Tensor, Tensor]:
        """rgb, depth, alpha."""
        rendering = render(Splats(*self.inputs), self.view, capacity=self.capacity)
        return rendering.rgb, rendering.depth, rendering.alpha

    def step(self) -> Sequence[Tensor]:
        """Forward and adjoint."""
        return torch.autograd.grad(self.render(), self.inputs, self.v_outputs)

    def work(self) -> dict[str, Callable[[], object]]:
        """All that is timed."""
        whole = {"cuda.forward_ms": self.render, "cuda.step_ms": self.step, "cuda.captured_step_ms": self.captured()}
        return {**whole, **self.stages()}

    def captured(self) -> Callable[[], None]:
        """A step of training in a graph: render, loss, adjoint, Adam."""
        parameters = SplatParameters(self.splats.to_gaussians(), RATES, device=self.view.viewmat.device)
        weight = torch.ones(self.view.height, self.view.width, device=self.view.viewmat.device)

        def train() -> None:
            rendering = render(parameters.splats(), self.view, capacity=self.capacity)
            weighted_mse(rendering.rgb, self.target, weight).backward()
            parameters.step()

        return capture(train)

    def stages(self) -> dict[str, Callable[[], object]]:
        """Each alone."""
        projected = project(Splats(*self.inputs), self.view)
        rendering = composite(projected, self.view, capacity=self.capacity)
        outputs = rendering.rgb, rendering.depth, rendering.alpha
        v_records = torch.randn_like(projected.records)
        grad = torch.autograd.grad
        return {
            "cuda.stage.project_ms": lambda: project(Splats(*self.inputs), self.view),
            "cuda.stage.composite_ms": lambda: composite(projected, self.view, capacity=self.capacity),
            "cuda.stage.composite_adjoint_ms": lambda: grad(
                outputs, projected.records, self.v_outputs, retain_graph=True
            ),
            "cuda.stage.project_adjoint_ms": lambda: grad(projected.records, self.inputs, v_records, retain_graph=True),
        }


def milliseconds(work: Callable[[], object]) -> float:
    """How long one of some steps in a row takes."""
    begin, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))
    torch.cuda.synchronize()
    begin.record()
    for _ in range(STEPS):
        work()
    end.record()
    torch.cuda.synchronize()
    return begin.elapsed_time(end) / STEPS
