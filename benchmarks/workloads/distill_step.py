"""How long a step of a distillation takes as the background grows: the loop should not notice.

One vehicle, the same frames, backgrounds of several sizes; their fits take turns, a round of all views each, in one
process.
"""

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from rich.progress import Progress

from benchmarks.metric import Metric
from benchmarks.workloads.surfaces import cover
from dwgs.distill import DistillConfig, FrozenView, distill
from dwgs.distill.layers import FrozenBackground
from dwgs.optimize import Step
from dwgs.scene import Camera
from dwgs.splat import Projected
from dwgs.splat.constants import TILE
from dwgs.street import Street

VIEWS = 8
"""Frames that teach, spread over the clip."""
WARM_UP, ROUNDS = 3, 12
"""Rounds before those that count, and these."""


def run(street: Street, counts: Sequence[int], progress: Progress, rounds: int = ROUNDS) -> list[Metric]:
    """Step times over backgrounds of ``counts`` Gaussians; the ratios are those to the first of them."""
    insertion = street.insertion()
    scene = street.oracle(insertion)
    (name, frames), *_ = scene.frames.items()
    chosen = [frames[i] for i in np.linspace(0, len(frames) - 1, VIEWS).round().astype(int)]
    scene = replace(scene, frames={name: tuple(chosen)}, tracks=())
    config = DistillConfig(steps=10 * VIEWS * (WARM_UP + rounds))
    task = progress.add_task("grow the background", total=len(counts) + WARM_UP + rounds)

    backgrounds, fits = [], []
    for count in counts:
        backgrounds.append(_Watched(cover(street, count), chosen))
        fits.append(distill(scene, backgrounds[-1], insertion, config))
        _round(fits[-1], 1)
        progress.advance(task)
    views = sum(1 for i in range(VIEWS) if i % 8 != 4)
    measured = []
    for done in range(WARM_UP + rounds):
        times = [_round(fit, views) for fit in fits]
        if done >= WARM_UP:
            measured.append(times)
        progress.advance(task)
    for fit in fits:
        fit.close()

    seconds = np.array(measured)  # [rounds, counts, views]
    metrics = []
    for k, (count, background) in enumerate(zip(counts, backgrounds, strict=True)):
        name, between = f"distill.background_{_short(count)}", background.watched
        steps = 1e3 * np.median(seconds[:, k], 1)
        metrics += [
            Metric(f"{name}.step", float(np.median(steps)), "ms", _spread(steps)),
            Metric(f"{name}.between", float(np.mean([b.gaussians for b in between])), ""),
            Metric(f"{name}.between_intersections", float(np.mean([b.intersections for b in between])), ""),
            Metric(f"{name}.freeze", float(np.mean([b.seconds for b in between])), "s"),
        ]
        if k:
            ratios = seconds[:, k].sum(1) / seconds[:, 0].sum(1)
            name = f"distill.step_ratio_{_short(count)}_over_{_short(counts[0])}"
            metrics.append(Metric(name, float(np.median(ratios)), "", _spread(ratios)))
    return metrics


@dataclass(frozen=True)
class _Between:
    """What one view keeps between its layers."""

    gaussians: int
    intersections: int
    """Of these with tiles."""
    seconds: float
    """To split the view."""


class _Watched(FrozenBackground):
    """A background that says how its views were split."""

    def __init__(self, background, frames) -> None:
        super().__init__(background, frames)
        self.watched: list[_Between] = []

    def freeze(self, camera: Camera, camera_name: str, interval: tuple[float, float]) -> FrozenView:
        begin = time.perf_counter()
        view = super().freeze(camera, camera_name, interval)
        seconds = time.perf_counter() - begin
        self.watched.append(_Between(len(view.between), _intersections(view.between, camera), seconds))
        return view


def _intersections(projected: Projected, camera: Camera) -> int:
    """Tiles that the ellipses' boxes touch, as the renderer deals them."""
    size = np.array([camera.width, camera.height])
    tiles = -(-size // TILE)
    means, radii = projected.means2d.numpy(), projected.radii.numpy()
    first = np.clip(np.floor((means - radii - 0.5) / TILE), 0, tiles)
    last = np.clip(np.floor((means + radii - 0.5) / TILE) + 1, 0, tiles)
    return int((last - first).prod(1).sum())


def _round(fit: Generator, steps: int) -> list[float]:
    """Seconds that each of so many steps took; what comes before the first of all counts to it."""
    seconds = []
    begin = time.perf_counter()
    for event in fit:
        if isinstance(event, Step):
            seconds.append(time.perf_counter() - begin)
            if len(seconds) == steps:
                break
            begin = time.perf_counter()
    return seconds


def _short(count: int) -> str:
    """As in 100k and 5m."""
    return f"{count // 10**6}m" if count % 10**6 == 0 else f"{count // 1000}k"


def _spread(values: np.ndarray) -> float:
    low, high = np.percentile(values, (25, 75))
    return float(high - low)
