"""Scene x Background x Insertion -> VehicleAsset: a vehicle is learnt while everything around it stands still."""

import math
import time
from collections.abc import Generator
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from typing import Any

import numpy as np

from dwgs.distill.config import RECORDED, DistillConfig
from dwgs.distill.layers import Frozen, FrozenBackground
from dwgs.distill.learner import Learner
from dwgs.distill.prepare import Prepared, prepare
from dwgs.distill.report import QUALITY, judge
from dwgs.distill.rolling import learn_wheels
from dwgs.distill.wheels import are_wheels_seen, find_wheels
from dwgs.optimize import Checkpoint, Evaluated, Event, count_steps, fill_time
from dwgs.scene import Background, InputError, Insertion, Scene, Trajectory, VehicleAsset
from dwgs.splat.parallel import torch_alone

ROLLING_STEPS, ROLLING_TIME = 0.35, 0.15
"""Shares of the steps, or of the time, that wheels get: the steps are made besides, the time is taken from the rest."""
UNSETTLED, LEAST_ROLLING = 20.0, 0.5
"""In less time than this [s], if time is given, the body needs all of it, and poses are hardly right enough to see
wheels turn; and if they are seen to, at least so much [s] is taken for them."""


@dataclass(frozen=True)
class Distilled:
    """What comes out of a video."""

    asset: VehicleAsset
    """The vehicle."""
    trajectory: Trajectory
    """Where it drove: the insertion's, or the refined one, which its Gaussians stand by."""
    report: dict[str, Any]
    """What was measured, as JSON values."""


def distill(
    scene: Scene,
    background: Background | Frozen,
    insertion: Insertion,
    config: DistillConfig | None = None,
    checkpoint: Checkpoint | None = None,
) -> Generator[Event, None, Distilled]:
    """Learn the vehicle that a scene shows, as Gaussians in its own frame; the background is frozen.

    A scene whose frames carry reactive masks is generated video: its vehicle is where the insertion says, and is
    learnt from every frame that shows it. Otherwise the vehicle was recorded, and the loss forgives what no rigid
    body does. The poses of a recorded vehicle are refined, and those of a path that trembles as no vehicle does.
    Every eighth frame is only scored. Where ``config.seconds`` are too few to prepare all frames, some teach, spread
    over the clip. A fit of so many steps goes on from its ``checkpoint``, to the same bytes; one of so many seconds
    begins anew.

    Yields events while it runs; returns what it `Distilled`. Raises `InputError` where no frame shows the vehicle,
    where a generated clip outlasts the trajectory, or where no time is left to fit.
    """
    config = config or DistillConfig()
    if config.steps < 1 or config.gaussians < 1 or (config.seconds is not None and not config.seconds > 0):
        raise InputError(f"a distillation has at least one step and one Gaussian, and some time, got {config}")
    started = time.monotonic()
    frozen = FrozenBackground(background, scene.all_frames()) if isinstance(background, Background) else background
    with torch_alone():
        return (yield from _distill(scene, frozen, insertion, config, checkpoint, started))


def _distill(
    scene: Scene,
    frozen: Frozen,
    insertion: Insertion,
    config: DistillConfig,
    checkpoint: Checkpoint | None,
    started: float,
) -> Generator[Event, None, Distilled]:
    """What `distill` does, in the time since it ``started`` [s]."""
    before, end = frozen.fingerprint(), started + (config.seconds or math.inf)
    prepared = yield from prepare(scene, frozen, insertion, config, end)
    begun = time.monotonic()
    if end <= begun:
        raise InputError(
            f"preparing took {begun - started:.1f} s of the {config.seconds:g} s given; give more, or fewer frames"
        )
    learnt = yield from _learn(prepared, config, checkpoint, end)
    fitted = time.monotonic()
    report, seen = yield from judge(prepared, learnt.asset, learnt.trajectory, config.threads)
    yield Evaluated(learnt.steps, report["psnr_roi_heldout"] or report["psnr_roi_train"])
    report |= {
        "wheels": learnt.wheels,
        "steps": learnt.steps,
        "seconds": {
            "prepare": round(begun - started, 2),
            "fit": round(fitted - begun, 2),
            "evaluate": round(time.monotonic() - fitted, 2),
        },
        "background_unchanged": frozen.fingerprint() == before,
    }
    provenance = {"scene": scene.name, "dwgs": version("dwgs"), "config": asdict(config), "background": before}
    provenance |= {key: report[key] for key in ("kind", "steps", "seconds")}
    quality = {key: report[key] for key in QUALITY if key in report}
    asset = replace(learnt.asset, provenance=provenance, quality=quality, observations=seen)
    return Distilled(asset, learnt.trajectory, report)


@dataclass(frozen=True)
class _Learnt:
    """What the frames taught."""

    asset: VehicleAsset
    trajectory: Trajectory
    """That it was learnt on."""
    steps: int
    wheels: dict[str, Any] | None
    """What is known of wheels that roll, as JSON values."""


def _learn(
    prepared: Prepared, config: DistillConfig, checkpoint: Checkpoint | None, end: float
) -> Generator[Event, None, _Learnt]:
    """Follow a schedule of so many steps, or until the ``end`` [s] of the monotonic clock, then let wheels roll."""
    insertion, poses, shots, left = prepared.insertion, prepared.poses, prepared.shots, end - time.monotonic()
    may_roll = left > UNSETTLED and prepared.recipe is RECORDED
    may_roll = may_roll and are_wheels_seen([(shot, shot.view) for shot in shots.values()], insertion.size)
    schedule = count_steps(config.steps)
    if config.seconds is not None:
        schedule, checkpoint = fill_time(left * (1 - ROLLING_TIME * may_roll)), None
    steps = yield from Learner(prepared, config).run(schedule, checkpoint)
    body, shadow, casting, shading = prepared.vehicle.finish()
    size = np.asarray(insertion.size)
    asset = VehicleAsset(body, shadow, size, insertion.category, casting=casting, shading=shading)
    trajectory = insertion.trajectory if poses is None else poses.refined(insertion.trajectory)
    rolling = None
    if may_roll:
        looks = [(shot, prepared.view(i, shot)) for i, shot in shots.items()]
        rolling = find_wheels(looks, size, trajectory, config.seed)
    if rolling is not None:
        schedule = count_steps(math.ceil(ROLLING_STEPS * config.steps))
        if config.seconds is not None:
            schedule = fill_time(max(end - time.monotonic(), LEAST_ROLLING))
        asset = yield from learn_wheels(rolling, asset, prepared.recipe, schedule, config.seed)
    wheels = None if rolling is None or not asset.wheels else rolling.report()
    return _Learnt(asset, trajectory, steps, wheels)
