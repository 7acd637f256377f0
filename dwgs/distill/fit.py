"""The loop: a vehicle is learnt while everything around it stands still."""

import math
import time
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from functools import partial

import numpy as np
import torch

from dwgs.distill.config import GENERATED, RECORDED, DistillConfig, Recipe
from dwgs.distill.coverage import Coverage
from dwgs.distill.evaluate import score, summary
from dwgs.distill.initialize import initialize_body
from dwgs.distill.layers import Frozen, FrozenBackground
from dwgs.distill.model import BoxPoses, Vehicle
from dwgs.distill.photometric import Photometric, photometric
from dwgs.distill.shadow import initialize_shadow
from dwgs.distill.shots import Shot, Sight, find_sights, prepare_shots
from dwgs.optimize import (
    Evaluated,
    Event,
    Grown,
    Step,
    count_steps,
    fill_time,
    hold_then_decay,
    view_order,
)
from dwgs.optimize.schedule import Pace
from dwgs.scene import Background, Gaussians, InputError, Insertion, Scene, VehicleAsset
from dwgs.splat import Drawing, RetainedCloud, Splats

PREPARING = 0.3
"""Share of the time that is left once the frames are chosen, if time is given, in which they are prepared."""
TAIL = 0.1
"""Fraction of the schedule, its end, over which the result is averaged."""
EVENNESS = (0.5, 2.0)
"""Bounds on the weight that makes every view equally heavy."""


def distill(
    scene: Scene, background: Background | Frozen, insertion: Insertion, config: DistillConfig | None = None
) -> Generator[Event, None, tuple[VehicleAsset, dict]]:
    """Learn the vehicle that a scene shows, as Gaussians in its own frame; the background is frozen.

    A scene whose frames carry reactive masks is generated video: its vehicle is exactly where the insertion
    says, and is learnt from every frame that shows it. Otherwise the vehicle was recorded: its box is refined
    in every frame, and the loss forgives what no rigid body does. Every eighth frame is only scored. Where
    ``config.seconds`` are too few to prepare all frames, some teach, spread over the clip.

    Yields events while it runs; returns the asset and a report of JSON values. Raises `InputError` where no
    frame shows the vehicle, where a generated clip outlasts the trajectory, or where no time is left to fit.
    """
    config = config or DistillConfig()
    if config.steps < 1 or config.gaussians < 1 or (config.seconds is not None and not config.seconds > 0):
        raise InputError(f"a distillation has at least one step and one Gaussian, and some time, got {config}")
    started = time.monotonic()
    frozen = FrozenBackground(background, scene.all_frames()) if isinstance(background, Background) else background
    before = frozen.fingerprint()
    is_generated = any(frame.load_reactive_mask is not None for frame in scene.all_frames())
    recipe = GENERATED if is_generated else RECORDED

    with ThreadPoolExecutor(1) as pool:
        body = pool.submit(initialize_body, insertion.vehicle, insertion.size, config.gaussians)
        sights = find_sights(scene, frozen, insertion, recipe, config.threads)
        shadow = initialize_shadow(insertion.size, config.shadow_margin, sights)
    vehicle = Vehicle(body.result(), shadow, insertion.size, recipe)
    yield Grown(0, len(vehicle))

    prepare = partial(
        prepare_shots,
        scene=scene,
        background=frozen,
        insertion=insertion,
        bounds=vehicle.bounds,
        threads=config.threads,
    )
    learnt = [i for i, sight in enumerate(sights) if not sight.held_out]
    order = view_order(len(learnt), config.seed)
    learnt = [learnt[next(order)] for _ in learnt]  # as many as there is time for, spread over the clip
    deadline = math.inf
    if config.seconds is not None:
        chosen = time.monotonic()
        deadline = chosen + PREPARING * (started + config.seconds - chosen)
    prepared_shots = yield from prepare([sights[i] for i in learnt], deadline=deadline)
    shots = dict(sorted(zip(learnt, prepared_shots, strict=False)))
    prepared = time.monotonic()

    poses = BoxPoses(len(sights)) if recipe.refines_poses else None
    if config.seconds is None:
        schedule = count_steps(config.steps)
    elif prepared - started < config.seconds:
        schedule = fill_time(config.seconds - (prepared - started))
    else:
        raise InputError(
            f"preparing took {prepared - started:.1f} s of the {config.seconds:g} s given; give more, or fewer frames"
        )
    steps = yield from _fit(shots, vehicle, poses, recipe, config, schedule)
    body, shadow = vehicle.finish()
    if poses is not None:
        times = np.array([sight.frame.camera.time for sight in sights])
        poses.interpolate(times, np.isin(np.arange(len(sights)), list(shots)))
    fitted = time.monotonic()

    taught = [sights[i] for i in shots]
    judged = [i for i, sight in enumerate(sights) if sight.held_out]
    shots |= dict(zip(judged, (yield from prepare([sights[i] for i in judged])), strict=True))
    report = _evaluate(dict(sorted(shots.items())), body, shadow, poses, config.threads)
    yield Evaluated(steps, report["psnr_roi_heldout"] or report["psnr_roi_train"])
    report |= _coverage(taught, insertion)
    report |= {
        "kind": "generated" if is_generated else "recorded",
        "gaussians": len(body) + len(shadow),
        "gaussians_body": len(body),
        "gaussians_shadow": len(shadow),
        "steps": steps,
        "frames_taught": len(taught),
        "seconds": {
            "prepare": round(prepared - started, 2),
            "fit": round(fitted - prepared, 2),
            "evaluate": round(time.monotonic() - fitted, 2),
        },
        "background_unchanged": frozen.fingerprint() == before,
    }
    provenance = {"scene": scene.name, "config": asdict(config), "background": before}
    quality = {key: report[key] for key in ("psnr_roi_heldout", "ssim_roi_heldout", "psnr_object_heldout")}
    quality |= {key: report[key] for key in ("azimuths", "side_pixels")}
    asset = VehicleAsset(body, shadow, np.asarray(insertion.size), insertion.category, provenance, quality)
    return asset, report


def _fit(
    shots: dict[int, Shot],
    vehicle: Vehicle,
    poses: BoxPoses | None,
    recipe: Recipe,
    config: DistillConfig,
    schedule: Iterator[Pace],
) -> Generator[Event, None, int]:
    """Run the schedule on ``shots`` by their number among all; gives how many steps it had."""
    learnt = list(shots)
    cloud = RetainedCloud(vehicle.splats(), config.threads, moves=poses is not None)
    pictures = {i: shot.frozen.retain(cloud, shot.view) for i, shot in shots.items()}
    judges: dict[int, tuple[Drawing, Photometric]] = {}
    squared_errors: dict[int, float] = {}
    order = view_order(len(learnt), config.seed)
    step = 0
    for pace in schedule:
        step, i = pace.step, learnt[next(order)]
        shot, picture, viewmat = shots[i], pictures[i], None
        if poses is not None and step > len(learnt):
            viewmat = shot.view_at(poses.old_from_new(i)).viewmat
            picture.viewmat.copy_(viewmat.detach())
        drawing = picture.draw()
        if i not in judges or judges[i][0] is not drawing:
            judges[i] = drawing, photometric(drawing, shot, recipe)
        loss = judges[i][1]()
        if not recipe.robust:
            squared_errors[i] = max(loss, 1e-8)
            mean = sum(squared_errors.values()) / len(squared_errors)
            drawing.v_rgb.mul_(float(np.clip((mean / squared_errors[i]) ** 0.5, *EVENNESS)))
        drawing.v_depth.zero_()
        drawing.v_alpha.zero_()
        if shot.lidar is not None and config.lidar_weight > 0:
            loss += shot.lidar.pull(drawing, config.lidar_weight)
        picture.adjoint()
        factor = hold_then_decay(pace.progress, recipe.hold, recipe.final)
        vehicle.step(factor, is_averaged=pace.progress > 1 - TAIL)
        if poses is not None and viewmat is not None:
            viewmat.backward(picture.v_viewmat)
            poses.step(factor)
        yield Step(step, pace.steps, loss)
    return step


def _evaluate(shots: dict[int, Shot], body: Gaussians, shadow: Gaussians, poses: BoxPoses | None, threads: int) -> dict:
    """Scores of every frame, held-out and learnt."""
    splats = Splats.from_gaussians(body), Splats.from_gaussians(shadow)
    with torch.no_grad():
        views = [s.view if poses is None else s.view_at(poses.old_from_new(i)) for i, s in shots.items()]
    with ThreadPoolExecutor(threads) as pool:  # a frame for each thread
        scores = pool.map(lambda shot, view: score(shot, view, *splats, threads=1)[0], shots.values(), views)
        return summary(list(scores))


def _coverage(taught: list[Sight], insertion: Insertion) -> dict:
    """From where the frames that taught the vehicle saw it."""
    coverage = Coverage(insertion.size)
    for sight in taught:
        camera = sight.region.window.camera(sight.camera)
        coverage.add(camera, sight.world_from_vehicle, sight.region.supervised)
    return coverage.report()
