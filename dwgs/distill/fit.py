"""Scene x Background x Insertion -> VehicleAsset: a vehicle is learnt while everything around it stands still."""

import math
import time
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.distill.config import GENERATED, RECORDED, DistillConfig
from dwgs.distill.coverage import Coverage
from dwgs.distill.evaluate import Score, of_sectors, score, summary
from dwgs.distill.initialize import find_surface, initialize_body
from dwgs.distill.layers import Frozen, FrozenBackground
from dwgs.distill.learner import Learner
from dwgs.distill.model import Vehicle, vehicle_bounds
from dwgs.distill.observe import observations
from dwgs.distill.poses import BoxPoses
from dwgs.distill.rolling import learn_wheels
from dwgs.distill.shadow import initialize_shadow
from dwgs.distill.shots import Shot, Sight, find_sights, prepare_shots
from dwgs.distill.sun import find_casting, turning
from dwgs.distill.symmetry import imagine, mirrored_share
from dwgs.distill.wheels import are_wheels_seen, find_wheels
from dwgs.optimize import Checkpoint, Evaluated, Event, Grown, count_steps, fill_time, view_order
from dwgs.scene import Background, Gaussians, InputError, Insertion, Scene, Trajectory, VehicleAsset
from dwgs.scene.pose import inverse
from dwgs.splat import Splats, View
from dwgs.splat.parallel import torch_alone

PREPARING = 0.3
"""Share of the time that is left once the frames are chosen, if time is given, in which they are prepared."""
PER_SECOND = 900
"""Gaussians of the body for each second, if time is given: fewer make more steps, which pays while those are few."""
EYES = 12
"""So many frames, spread over the clip, say which sides they see."""
ROLLING_STEPS, ROLLING_TIME = 0.35, 0.15
"""Shares of the steps, or of the time, that wheels get: the steps are made besides, the time is taken from the rest."""
UNSETTLED, LEAST_ROLLING = 20.0, 0.5
"""In less time than this [s], if time is given, the body needs all of it, and poses are hardly right enough to see
wheels turn; and if they are seen to, at least so much [s] is taken for them."""
COMPLETED = "share_completed_by_symmetry"
"""Key of a report."""
SOLID = 0.5
"""Opacity of a Gaussian that counts for the vehicle's extent."""


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
    before = frozen.fingerprint()
    is_generated = any(frame.load_reactive_mask is not None for frame in scene.all_frames())
    recipe = GENERATED if is_generated else RECORDED

    sights = find_sights(scene, frozen, insertion, recipe, config.threads)
    count = math.ceil(min(config.gaussians, PER_SECOND * (config.seconds or math.inf)))
    with ThreadPoolExecutor(1) as pool:
        outside = pool.submit(find_surface, insertion.vehicle, insertion.size)
        body = pool.submit(lambda: initialize_body(outside.result(), count, _eyes(sights)))
        shadow = initialize_shadow(insertion.size, config.shadow_margin, sights)
    surface, discs = outside.result(), body.result()
    yield Grown(0, len(discs) + len(shadow))
    poses: BoxPoses | None = BoxPoses(sights, recipe, config.threads)
    if not (recipe.refines_poses or poses.is_rough()):
        poses = None

    prepare = partial(
        prepare_shots,
        scene=scene,
        background=frozen,
        insertion=insertion,
        bounds=vehicle_bounds(insertion.size, shadow, config.shadow_margin * turning(sights)),
        threads=config.threads,
        refines_poses=poses is not None,
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
    casting = find_casting(list(shots.values()), insertion, shadow, config.shadow_margin)
    imagined = None
    if config.symmetry and insertion.vehicle.is_complete:  # a scan's far side is mirrored as it is, with its light
        sun = None if casting is None else casting.sun_at_rest
        imagined = imagine(discs, surface, list(shots.values()), sun, config.threads)
    begun = discs if imagined is None else imagined.body
    vehicle = Vehicle(begun, shadow, insertion.size, recipe, casting)
    may_roll = not is_generated and are_wheels_seen([(shot, shot.view) for shot in shots.values()], insertion.size)
    prepared = time.monotonic()

    schedule = count_steps(config.steps)
    if config.seconds is not None:
        left = started + config.seconds - prepared
        if left <= 0:
            raise InputError(
                f"preparing took {prepared - started:.1f} s of the {config.seconds:g} s given; "
                "give more, or fewer frames"
            )
        may_roll &= left > UNSETTLED
        schedule = fill_time(left * (1 - ROLLING_TIME * may_roll))
    learner = Learner(shots, vehicle, poses, imagined, recipe, config)
    steps = yield from learner.run(schedule, checkpoint if config.seconds is None else None)
    body, shadow, casting, shading = vehicle.finish()
    size = np.asarray(insertion.size)
    asset = VehicleAsset(body, shadow, size, insertion.category, casting=casting, shading=shading)

    def view_of(i: int) -> View:
        return shots[i].view if poses is None else shots[i].view_at(poses.old_from_new(i))

    trajectory = insertion.trajectory if poses is None else poses.refined(insertion.trajectory)
    rolling = None
    if may_roll:
        rolling = find_wheels([(shots[i], view_of(i)) for i in shots], asset.size, trajectory, config.seed)
    if rolling is not None:
        schedule = count_steps(math.ceil(ROLLING_STEPS * config.steps))
        if config.seconds is not None:
            schedule = fill_time(max(started + config.seconds - time.monotonic(), LEAST_ROLLING))
        asset = yield from learn_wheels(rolling, asset, recipe, schedule, config.seed)
    body = asset.body
    fitted = time.monotonic()

    taught = [sights[i] for i in shots]
    judged = [i for i, sight in enumerate(sights) if sight.held_out]
    shots |= dict(zip(judged, (yield from prepare([sights[i] for i in judged])), strict=True))
    corrected = {} if poses is None else poses.report()
    looks = ((shots[i], view_of(i), _standing(shots[i], asset, trajectory)) for i in learnt if i in shots)
    seen = observations(looks, len(body), config.threads)
    scores = _scores([(shots[i], view_of(i)) for i in sorted(shots)], asset, trajectory, config.threads)
    report = summary(scores) | _coverage(taught, insertion, scores) | corrected
    yield Evaluated(steps, report["psnr_roi_heldout"] or report["psnr_roi_train"])
    is_mirrored = imagined is not None or not insertion.vehicle.is_complete
    report |= {
        "kind": "generated" if is_generated else "recorded",
        "gaussians": len(body) + len(shadow),
        "gaussians_body": len(body),
        "gaussians_shadow": len(shadow),
        "gaussians_unseen": int((seen == 0).sum()),
        COMPLETED: round(mirrored_share(body, seen), 4) if is_mirrored else 0.0,
        "size": [float(side) for side in insertion.size],
        "extent": extent(body),
        "wheels": None if rolling is None or not asset.wheels else rolling.report(),
        "steps": steps,
        "frames_taught": len(taught),
        "seconds": {
            "prepare": round(prepared - started, 2),
            "fit": round(fitted - prepared, 2),
            "evaluate": round(time.monotonic() - fitted, 2),
        },
        "background_unchanged": frozen.fingerprint() == before,
    }
    told = ("psnr_roi_heldout", "ssim_roi_heldout", "psnr_object_heldout", "sectors", "side_pixels")
    told += ("gaussians_unseen", COMPLETED, "extent", "wheels", "frames_taught")
    quality = {key: report[key] for key in told} | corrected
    provenance = {"scene": scene.name, "kind": report["kind"], "dwgs": version("dwgs"), "config": asdict(config)}
    provenance |= {"steps": steps, "seconds": report["seconds"], "background": before}
    asset = replace(asset, provenance=provenance, quality=quality, observations=seen)
    return Distilled(asset, trajectory, report)


def _eyes(sights: list[Sight]) -> list[NDArray[np.float64]]:
    """[3] in the vehicle's frame: where cameras look from, spread over the clip."""
    spread = np.unique(np.linspace(0, len(sights) - 1, EYES).astype(int))
    return [(inverse(sights[i].world_from_vehicle) @ sights[i].camera.world_from_camera)[:3, 3] for i in spread]


def _standing(shot: Shot, asset: VehicleAsset, trajectory: Trajectory) -> Gaussians:
    """All of the asset as it stands in a frame, in the order of its Gaussians."""
    parts = asset.parts_at(trajectory, shot.sight.frame.camera.time)
    return Gaussians.concatenate([*parts, asset.shadow_at(shot.sight.world_from_vehicle)])


def _scores(shots: list[tuple[Shot, View]], asset: VehicleAsset, trajectory: Trajectory, threads: int) -> list[Score]:
    """Of every frame, held-out and learnt."""

    def judge(look: tuple[Shot, View]) -> Score:
        whole, count = _standing(look[0], asset, trajectory), len(asset.body)
        body, shadow = Splats.from_gaussians(whole[:count]), Splats.from_gaussians(whole[count:])
        return score(*look, body, shadow, threads=1)[0]

    with ThreadPoolExecutor(threads) as pool:  # a frame for each thread
        return list(pool.map(judge, shots))


def extent(body: Gaussians) -> list[float]:
    """Length, width and height [m] that hold all but a hundredth of what is solid: to be held against the box."""
    solid = body.means[body.opacities > SOLID]
    if not len(solid):
        return [0.0, 0.0, 0.0]
    return [round(float(side), 3) for side in np.subtract(*np.quantile(solid, [0.995, 0.005], axis=0))]


def _coverage(taught: list[Sight], insertion: Insertion, scores: list[Score]) -> dict:
    """From where the frames that taught the vehicle saw it, and how good it is from there."""
    coverage = Coverage(insertion.size)
    for sight in taught:
        camera = sight.region.window.camera(sight.camera)
        coverage.add(camera, sight.world_from_vehicle, sight.region.supervised)
    report = coverage.report()
    return report | {"sectors": of_sectors(scores, report["sectors"])}
