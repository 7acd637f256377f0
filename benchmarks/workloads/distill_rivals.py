"""How much sooner the same quality is reached than by the loop that the field ships.

Everyone has the same video, vehicle, trajectory and held-out frames, and is scored over the same pixels: before the
background, or who only knows a flat image of that, before the image. Rivals prepare for nothing and are judged outside
their time; ours decodes and splits the background within its own.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.progress import Progress

from benchmarks.metric import Metric
from benchmarks.rivals.loops import Crops, FullFrames, Loop, Scenery
from benchmarks.rivals.omnire import RigidNode, Schedule, scene_radius
from benchmarks.workloads.oracle import follow
from benchmarks.workloads.reconstructed_street import oracle
from dwgs.datasets import folder
from dwgs.distill import DistillConfig, distill
from dwgs.distill.config import GENERATED
from dwgs.distill.evaluate import score
from dwgs.distill.layers import FrozenBackground
from dwgs.distill.model import body_bounds, shadow_bounds
from dwgs.distill.shadow import initialize_shadow
from dwgs.distill.shots import Shot, find_sights, prepare_shots
from dwgs.metrics import psnr
from dwgs.reconstruct import ReconstructConfig, reconstruct
from dwgs.scene import Gaussians
from dwgs.splat import Splats
from dwgs.street import Street

FIRST, FACTOR = 5.0, 1.15
"""Rivals are judged after so many seconds, and again after so many times as long."""
SLACK = 0.5
"""Between two culls a rival's Gaussians may leave their bounds, by which frames are judged, so far [m]."""


@dataclass(frozen=True)
class Race:
    """Who is held against whom, and for how long."""

    ours: float
    """Seconds given to ours; what it reaches then is the quality in question."""
    budget: float
    """Seconds after which a rival is given up."""
    steps: int
    """Length of the rivals' schedule."""
    reconstruction: ReconstructConfig
    """Of the street, which becomes the background."""


@dataclass(frozen=True)
class Finish:
    """What became of a rival."""

    seconds: float
    """To the quality asked for; all it had, if that was not reached."""
    is_reached: bool
    psnr: float
    """[dB] held out, when it was judged last."""
    steps: int
    """Until then."""
    gaussians: int
    step: float
    """Median time [s] of its steps, those before images have their full size left out (NaN: it had no others)."""


def run(street: Street, race: Race, progress: Progress) -> list[Metric]:
    """Ours once, then each rival until it is as good or out of time."""
    fit = reconstruct(street.scene(), race.reconstruction)
    background, _ = follow(fit, progress, "reconstruct")
    insertion = street.insertion()
    scene, background = oracle(street, insertion, background)
    with TemporaryDirectory() as temporary:
        video = Path(temporary) / "oracle"
        task = progress.add_task("film the reconstruction", total=street.frames)
        folder.write(scene, video, lambda done, _: progress.update(task, completed=done))
        scene = folder.read(video)
        config = DistillConfig(seconds=race.ours)
        report = follow(distill(scene, background, insertion, config), progress, "ours").report
        goal, ours = report["psnr_roi_heldout"], report["seconds"]["prepare"] + report["seconds"]["fit"]

        frozen = FrozenBackground(background, scene.all_frames())
        sights = find_sights(scene, frozen, insertion, GENERATED, config.threads)
        shadow = initialize_shadow(insertion.size, config.shadow_margin, sights)
        limits = body_bounds(insertion.size), shadow_bounds(insertion.size, shadow)
        bounds = np.stack([np.minimum(limits[0][0], limits[1][0]), np.maximum(limits[0][1], limits[1][1])])
        wide = bounds + np.array([[-SLACK], [SLACK]])
        shots: list[Shot] = follow(
            prepare_shots(sights, scene, frozen, insertion, wide, config.threads), progress, "prepare rivals"
        )
    learnt, judged = ([s for s in shots if s.sight.held_out == held_out] for held_out in (False, True))
    schedule = Schedule(race.steps, len(learnt))
    radius = scene_radius(street.scene().sweeps)
    metrics = [
        Metric("distill.street.rivals.background_gaussians", len(background.gaussians), ""),
        Metric("distill.street.rivals.psnr", goal, "dB"),
        Metric("distill.street.rivals.ours", ours, "s"),
        Metric("distill.street.rivals.our_steps", report["steps"], ""),
    ]

    def run_rival(name: str, scenery: Scenery, judge: Callable[[Splats], float]) -> Finish:
        loop = Loop(RigidNode(insertion.vehicle, shadow, bounds, radius, schedule), scenery, schedule)
        return chase(loop, lambda: judge(loop.splats()), goal, race.budget, progress, name)

    flat = Crops(judged, config.threads)
    crop = run_rival("crop_loop", Crops(learnt, config.threads), lambda splats: flat_psnr(splats, flat, judged))
    frames = FullFrames(learnt, background, config.threads)
    field = run_rival("field_loop", frames, lambda splats: layered_psnr(splats, judged))
    return metrics + _metrics("crop_loop", crop, ours) + _metrics("field_loop", field, ours)


def chase(loop: Loop, judge: Callable[[], float], goal: float, budget: float, progress: Progress, title: str) -> Finish:
    """Step until ``judge`` says ``goal`` [dB], or until ``budget`` [s] are over; judging takes no time.

    The moment is interpolated between the last two judgements.
    """
    task = progress.add_task(title, total=budget)
    times: list[float] = []
    spent, due, before = 0.0, min(FIRST, budget), (0.0, judge())
    while True:
        begin = time.perf_counter()
        loop.step()
        times.append(time.perf_counter() - begin)
        spent += times[-1]
        progress.update(task, completed=min(spent, budget))
        if spent < due:
            continue
        quality = judge()
        if quality >= goal or spent >= budget:
            break
        before, due = (spent, quality), min(spent * FACTOR, budget)
    is_reached = quality >= goal
    if is_reached:
        share = (goal - before[1]) / max(quality - before[1], 1e-9)
        spent = before[0] + max(share, 0.0) * (spent - before[0])
    steps = int(np.searchsorted(np.cumsum(times), spent)) + 1
    step = float(np.median(times[loop.schedule.coarse_steps :] or [np.nan]))
    return Finish(spent, is_reached, quality, min(steps, len(times)), len(loop.node), step)


def flat_psnr(splats: Splats, scenery: Scenery, shots: Sequence[Shot]) -> float:
    """[dB] over the regions, before the flat image: nothing of the background may hide what was learnt without it."""
    drawn = [scenery.draw(i, 1, splats)[:2] for i in range(len(shots))]
    masks = [shot.sight.region.supervised for shot in shots]
    return float(np.mean([psnr(a.numpy(), b.numpy(), mask) for (a, b), mask in zip(drawn, masks, strict=True)]))


def layered_psnr(splats: Splats, shots: Sequence[Shot]) -> float:
    """[dB] over the regions, as `distill` reports it: the background stands where it stands."""
    nothing = Splats.from_gaussians(Gaussians.empty())
    return float(np.mean([score(shot, shot.view, splats, nothing, threads=2)[0].psnr_roi for shot in shots]))


def _metrics(name: str, finish: Finish, ours: float) -> list[Metric]:
    """A rival that did not arrive has bounds alone, and their keys say so."""
    bound = "" if finish.is_reached else "_at_least"
    return [
        Metric(f"distill.street.speedup_over_{name}{bound}", finish.seconds / ours, "x"),
        Metric(f"distill.street.{name}.seconds_to_quality{bound}", finish.seconds, "s"),
        Metric(f"distill.street.{name}.psnr", finish.psnr, "dB"),
        Metric(f"distill.street.{name}.steps", finish.steps, ""),
        Metric(f"distill.street.{name}.step", 1e3 * finish.step, "ms"),
        Metric(f"distill.street.{name}.gaussians", finish.gaussians, ""),
    ]
