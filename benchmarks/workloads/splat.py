"""The splatter's time and memory, beside a plain C++ loop (the practical limit on that CPU) and torch.

What is compared is measured in turn, round by round, and a ratio is that of one round: whatever else the machine
does falls on both. A value is the median over the rounds, its spread the interquartile range. Stages and rivals run
on one thread and are timed by the processor's clock; whole steps by the wall's.
"""

import ctypes
import re
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from torch import Tensor

from benchmarks.metric import Metric
from benchmarks.rivals import dense
from benchmarks.rivals.cpp import Cpp
from dwgs.splat import Picture, RetainedCloud, Splats, View, composite, project, render
from dwgs.splat.ops.binned import Binned
from dwgs.splat.ops.composite import bin

M_MMAP_THRESHOLD = -3
"""Of ``mallopt``."""
WARM_UP = 2
"""Rounds that are not counted."""
STEPS = 5
"""In a row, after one that does not count."""
TORCH_EVERY = 4
"""Rounds from one of torch to the next: it takes longer than all the rest."""


def car(count: int) -> tuple[Splats, View]:
    """So many Gaussians of 3 cm in a car-shaped box of 4.5x1.9x1.5 m, 13.5 m away and turned by 35 degrees."""
    random = np.random.default_rng(0)
    points = random.normal(size=(count, 3))
    half = np.array([4.5, 1.9, 1.5]) / 2
    points /= (np.abs(points / half) ** 4).sum(1, keepdims=True) ** 0.25  # onto a superellipsoid
    inner = random.random(count) > 0.7
    points[inner] *= random.random((inner.sum(), 1)) ** (1 / 3)
    scales = np.exp(random.normal(np.log(0.03), 0.4, (count, 3)))
    sin, cos = np.sin(np.radians(35)), np.cos(np.radians(35))
    camera_from_car = np.array([[-sin, -cos, 0, 0], [0, 0, -1, 0], [cos, -sin, 0, 13.5], [0, 0, 0, 1]])
    return _cloud(random, points, scales), _view(camera_from_car, 620, 720, 480)


def full_frame(count: int, width: int, height: int) -> tuple[Splats, View]:
    """So many Gaussians all over the image and a little beyond, 5 to 50 m away, of 1.5 px (one sigma)."""
    random = np.random.default_rng(0)
    focal = 620 / 720 * width
    depths = random.uniform(5, 50, (count, 1))
    pixels = random.uniform(-0.55, 0.55, (count, 2)) * (width, height)
    points = np.hstack([pixels / focal, np.ones((count, 1))]) * depths
    scales = np.exp(random.normal(np.log(1.5), 0.5, (count, 3))) * depths / focal
    return _cloud(random, points, scales), _view(np.eye(4), focal, width, height)


def _cloud(random: np.random.Generator, points: NDArray, scales: NDArray) -> Splats:
    count = len(points)
    opacities = 1 / (1 + np.exp(-random.normal(0, 1.5, count)))
    arrays = (points, random.normal(size=(count, 4)), scales, opacities, random.normal(0, 0.3, (count, 4, 3)))
    return Splats(*(torch.tensor(array, dtype=torch.float32) for array in arrays))


def _view(viewmat: NDArray, focal: float, width: int, height: int) -> View:
    return View(torch.tensor(viewmat, dtype=torch.float32), (focal, focal, width / 2, height / 2), width, height)


SCENES: dict[str, Callable[[], tuple[Splats, View]]] = {
    "car5k": partial(car, 5_000),
    "car20k": partial(car, 20_000),
    "car100k": partial(car, 100_000),
    "full200k": partial(full_frame, 200_000, 720, 480),
    "street1m": partial(full_frame, 1_000_000, 1920, 1080),
}
"""Procedural, and the same every time."""


def run(scenes: Sequence[str], torch_scenes: Sequence[str], devices: Sequence[str], repeats: int) -> list[Metric]:
    """Time and memory of each scene on each device; torch is a rival in ``torch_scenes`` only."""
    metrics = run_on_cpu(scenes, torch_scenes, repeats) if "cpu" in devices else []
    if "cuda" in devices and not torch.cuda.is_available():
        Console(stderr=True).print("no CUDA device: nothing is measured on a GPU")
    elif "cuda" in devices:
        from benchmarks.workloads import splat_cuda

        for name in scenes:
            metrics += splat_cuda.measure(name, *SCENES[name](), repeats)
    return metrics


def run_on_cpu(scenes: Sequence[str], torch_scenes: Sequence[str], repeats: int) -> list[Metric]:
    """As `run`."""
    metrics = []
    for name in scenes:
        ours = Ours(*SCENES[name]())
        records = project(ours.splats, ours.view).records.detach()
        rivals = Rivals(records, ours.bin(records), ours.view, ours.v_image)
        metrics += compare(name, ours, rivals, repeats, name in torch_scenes)
        count = rivals.cpp.count()
        metrics.append(Metric(f"splat.{name}.lanes_per_live_pair", count.lanes / count.live, ""))
        metrics += memory(name, len(records), len(rivals.cpp.slots))
    return metrics


class Ours:
    """The splatter at work on one scene."""

    def __init__(self, splats: Splats, view: View) -> None:
        self.inputs = [getattr(splats, f.name).requires_grad_() for f in fields(Splats)]
        self.splats, self.view = Splats(*self.inputs), view
        across, down = view.tiles
        self.v_image = torch.zeros(5, 16 * down, 16 * across)
        """[5, H', W'] gradient of some loss: any numbers in the image, zero outside."""
        inside = self.v_image[:, : view.height, : view.width]
        inside.copy_(torch.randn(inside.shape, generator=torch.Generator().manual_seed(0)))
        self.v_outputs = inside[:3].movedim(0, -1), inside[3], inside[4]

        self._pictures: dict[int, Picture] = {}

    def step(self, threads: int) -> None:
        """Everything but the loss, as a fit does it: draw, and carry the gradient by the images to the Gaussians."""
        if threads not in self._pictures:
            self._pictures[threads] = RetainedCloud(self.splats, threads).picture(self.view)
            drawing = self._pictures[threads].draw()
            for v_image, v_output in zip(
                (drawing.v_rgb, drawing.v_depth, drawing.v_alpha), self.v_outputs, strict=True
            ):
                v_image.copy_(v_output)
        self._pictures[threads].draw()
        self._pictures[threads].adjoint()

    def step_by_autograd(self, threads: int) -> Sequence[Tensor]:
        """The same for whoever renders something else every time."""
        rendering = render(self.splats, self.view, threads=threads)
        outputs = rendering.rgb, rendering.depth, rendering.alpha
        return torch.autograd.grad(outputs, self.inputs, self.v_outputs)

    def bin(self, records: Tensor) -> Binned:
        """Tiles of the records [N, 16], on one thread."""
        return bin(records[None], self.view, capacity=None, threads=1)

    def stages(self) -> dict[str, float]:
        """Time of each stage on one thread [ms]; the adjoint of compositing ends with the gradient of records."""
        marks = [time.process_time()]

        def done(result):
            marks.append(time.process_time())
            return result

        projected = done(project(self.splats, self.view, threads=1))
        done(self.bin(projected.records.detach()))
        rendering = done(composite(projected, self.view, threads=1))
        outputs = rendering.rgb, rendering.depth, rendering.alpha
        v_records = done(torch.autograd.grad(outputs, projected.records, self.v_outputs))
        done(torch.autograd.grad(projected.records, self.inputs, v_records))
        names = "project", "bin", "composite", "composite_adjoint", "project_adjoint"
        times = dict(zip(names, (1e3 * np.diff(marks)).tolist(), strict=True))
        return {**times, "composite": times["composite"] - times["bin"]}  # which it does itself, too


class Rivals:
    """Others who composite the same records [N, 16], binned the same way, on one thread."""

    def __init__(self, records: Tensor, binned: Binned, view: View, v_image: Tensor) -> None:
        self.cpp = Cpp(records, binned, view)
        self.v_image = v_image
        self._scene = records.requires_grad_(), binned, view

    def run_cpp(self) -> None:
        """The C++ loop, forward and adjoint, to the gradient of records."""
        self.cpp.composite()
        self.cpp.composite_adjoint(self.v_image)

    def run_torch(self) -> None:
        """Dense torch, forward and adjoint, to the gradient of records."""
        torch.autograd.grad(dense.composite(*self._scene), self._scene[0], self.v_image)


def compare(name: str, ours: Ours, rivals: Rivals, repeats: int, with_torch: bool) -> list[Metric]:
    """Times and their ratios: median and spread."""
    samples: dict[tuple[str, str], list[float]] = defaultdict(list)
    for number in track(range(-WARM_UP, repeats), name, console=Console(stderr=True), transient=True):
        times, ratios = one_round(ours, rivals, with_torch and number % TORCH_EVERY == 0)
        if number >= 0:
            for unit, values in (("ms", times), ("", ratios)):
                for key, value in values.items():
                    samples[key, unit].append(value)
    metrics = []
    for (key, unit), values in samples.items():
        low, median, high = np.quantile(values, [0.25, 0.5, 0.75]).tolist()
        metrics.append(Metric(f"splat.{name}.{key}", median, unit, high - low))
    return metrics


def one_round(ours: Ours, rivals: Rivals, with_torch: bool) -> tuple[dict[str, float], dict[str, float]]:
    """Times [ms] and ratios by key, everybody once."""
    torch.set_num_threads(1)
    stages = ours.stages()
    composite_ms = stages["composite"] + stages["composite_adjoint"]
    times = {"composite_ms": composite_ms, "cpp_ms": milliseconds(rivals.run_cpp, time.process_time)}
    if with_torch:
        times["torch_ms"] = milliseconds(rivals.run_torch, time.process_time)
    times["step_ms_1_thread"] = steady_milliseconds(lambda: ours.step(1))
    torch.set_num_threads(2)
    times["step_ms"] = steady_milliseconds(lambda: ours.step(2))
    times["autograd_step_ms"] = steady_milliseconds(lambda: ours.step_by_autograd(2))
    ratios = {"speedup_2_threads": times["step_ms_1_thread"] / times["step_ms"]}
    if rivals.cpp.is_limit:
        ratios["ratio_to_cpp"] = composite_ms / times["cpp_ms"]
    if with_torch:
        ratios["speedup_over_torch"] = times["torch_ms"] / composite_ms
    return {**times, **{f"stage.{stage}_ms": value for stage, value in stages.items()}}, ratios


def milliseconds(work: Callable[[], object], clock: Callable[[], float]) -> float:
    """How long it takes by a clock in seconds."""
    start = clock()
    work()
    return 1e3 * (clock() - start)


def steady_milliseconds(step: Callable[[], object]) -> float:
    """How long one of many steps takes by the clock on the wall, as in a fit: the median of some in a row."""
    return float(np.median([milliseconds(step, time.perf_counter) for _ in range(1 + STEPS)][1:]))


def memory(name: str, gaussians: int, intersections: int) -> list[Metric]:
    """Peak of one step, and what of it grows with the cloud: measured, in three fresh processes.

    The whole scene, less the scene with every Gaussian behind the camera, is the intersections' part; that less the
    scene without Gaussians is the Gaussians' part; the rest are images.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([__name__])
    peaks = []
    for what in ("whole", "undrawn", "empty"):
        with ProcessPoolExecutor(1, mp_context=context) as fresh:
            peaks.append(fresh.submit(grown_bytes, name, what).result())
    whole, undrawn, empty = peaks
    return [
        Metric(f"splat.{name}.intersections", intersections, ""),
        Metric(f"splat.{name}.peak_bytes", whole, "B"),
        Metric(f"splat.{name}.bytes_per_gaussian", (undrawn - empty) / gaussians, "B"),
        Metric(f"splat.{name}.bytes_per_intersection", (whole - undrawn) / intersections, "B"),
    ]


def grown_bytes(name: str, what: Literal["whole", "undrawn", "empty"]) -> int:
    """Peak resident memory of this process's first step on a scene, above what it holds before; Linux tells."""
    splats, view = car(100)
    Ours(splats, replace(view, width=64, height=64)).step_by_autograd(2)  # loads kernels, starts threads
    splats, view = SCENES[name]()
    if what == "undrawn":
        turn = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]))
        view = replace(view, viewmat=turn @ view.viewmat)
    elif what == "empty":
        splats = Splats(*(getattr(splats, f.name)[:0] for f in fields(Splats)))
    ours = Ours(splats, view)
    libc = ctypes.CDLL(None)
    libc.mallopt(M_MMAP_THRESHOLD, 1 << 16)  # what is freed goes back at once
    libc.malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts here
    before = _resident("VmRSS")
    ours.step_by_autograd(2)
    return _resident("VmHWM") - before


def _resident(field: str) -> int:
    match = re.search(rf"{field}:\s*(\d+) kB", Path("/proc/self/status").read_text())
    assert match, f"/proc/self/status has no {field}"
    return 1024 * int(match[1])
