"""All that a fit begins with: the frames that teach, and the vehicle as it is before the first step."""

import math
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dwgs.distill.config import GENERATED, RECORDED, DistillConfig, Recipe
from dwgs.distill.initialize import find_surface, initialize_body
from dwgs.distill.layers import Frozen
from dwgs.distill.model import Vehicle, vehicle_bounds
from dwgs.distill.poses import BoxPoses
from dwgs.distill.shadow import initialize_shadow
from dwgs.distill.shots import Shot, Sight, find_sights, prepare_shots
from dwgs.distill.sun import find_casting, turning
from dwgs.distill.symmetry import Imagined, imagine
from dwgs.optimize import Event, Grown, view_order
from dwgs.scene import Insertion, Scene
from dwgs.scene.pose import inverse
from dwgs.splat import View

PREPARING = 0.3
"""Share of the time that is left once the frames are chosen, if time is given, in which they are prepared."""
PER_SECOND = 900
"""Gaussians of the body for each second, if time is given: fewer make more steps, which pays while those are few."""
EYES = 12
"""So many frames, spread over the clip, say which sides they see."""


@dataclass(frozen=True)
class Prepared:
    """What there is before the first step."""

    insertion: Insertion
    """What is learnt, and where it drives."""
    recipe: Recipe
    """How to learn it."""
    sights: list[Sight]
    """The frames that show the vehicle."""
    shots: dict[int, Shot]
    """Those of them that teach, by number."""
    load: Callable[[list[Sight]], Generator[Event, None, list[Shot]]]
    """Prepares others likewise."""
    vehicle: Vehicle
    """As it begins, to be changed."""
    poses: BoxPoses | None
    """Of its box, to be changed; None: they are right."""
    imagined: Imagined | None
    """How it looks where no frame looks; None: nobody knows."""

    def view(self, i: int, shot: Shot) -> View:
        """How frame i sees the vehicle where it is known to be by now."""
        return shot.view if self.poses is None else shot.view_at(self.poses.old_from_new(i))


def prepare(
    scene: Scene, frozen: Frozen, insertion: Insertion, config: DistillConfig, end: float
) -> Generator[Event, None, Prepared]:
    """Look for the vehicle in the frames of a scene, and load as many as there is time for until the ``end`` [s] of the
    monotonic clock. Raises what `distill` does.
    """
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

    load = partial(
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
    now = time.monotonic()
    loaded = yield from load([sights[i] for i in learnt], deadline=now + PREPARING * (end - now))
    shots = dict(sorted(zip(learnt, loaded, strict=False)))
    casting = find_casting(list(shots.values()), insertion, shadow, config.shadow_margin)
    imagined = None
    if config.symmetry and insertion.vehicle.is_complete:  # a scan's far side is mirrored as it is, with its light
        sun = None if casting is None else casting.sun_at_rest
        imagined = imagine(discs, surface, list(shots.values()), sun, config.threads)
    vehicle = Vehicle(discs if imagined is None else imagined.body, shadow, insertion.size, recipe, casting)
    return Prepared(insertion, recipe, sights, shots, load, vehicle, poses, imagined)


def _eyes(sights: list[Sight]) -> list[NDArray[np.float64]]:
    """[3] in the vehicle's frame: where cameras look from, spread over the clip."""
    spread = np.unique(np.linspace(0, len(sights) - 1, EYES).astype(int))
    return [(inverse(sights[i].world_from_vehicle) @ sights[i].camera.world_from_camera)[:3, 3] for i in spread]
