"""What each frame brings to the fit: its pixels, its region, and the frozen background around the vehicle."""

import math
import time
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.distill.config import Recipe
from dwgs.distill.layers import Frozen, FrozenView, depth_interval
from dwgs.distill.lidar import LidarDepths, carried_depths, static_depths
from dwgs.distill.region import Region, find_region, visible_fraction
from dwgs.optimize import Preparing
from dwgs.scene import Camera, Frame, InputError, Insertion, Scene
from dwgs.splat import View

HOLD_OUT_EVERY, HOLD_OUT_AT = 8, 4
"""Frame 4, 12, 20, ... of each camera's clip is never learnt from."""
ENOUGH = 32
"""Frames that are prepared however long it takes: more steps on fewer of them teach less."""
POSE_SLACK = 0.6
"""Room [m] in the depth interval where boxes are refined."""


@dataclass(frozen=True)
class Sight:
    """A frame that shows the vehicle."""

    frame: Frame
    """Pixels and recorded pose."""
    camera: Camera
    """Through which the vehicle is seen: the generator's, or the refined one of a recorded frame."""
    background_camera: Camera
    """Through which the background is seen: as it was fitted."""
    world_from_vehicle: NDArray[np.float64]
    """[4, 4]."""
    region: Region
    """Which pixels count."""
    held_out: bool
    """Whether it is for scoring alone."""


@dataclass(frozen=True)
class Shot:
    """A sight ready for the loop: everything in tensors, cut to the region's window."""

    sight: Sight
    view: View
    """From the vehicle's frame into the window."""
    frozen: FrozenView
    """The background there."""
    pixels: NDArray[np.uint8]
    """[h, w, 3] the frame."""
    target: Tensor
    """[h, w, 3] in [0, 1]: the frame; the background alone where nothing of the vehicle may show."""
    weight: Tensor
    """[h, w] 0 on other traffic, else 1."""
    lidar: LidarDepths | None
    """Depths to agree with."""

    def view_at(self, old_from_new: NDArray[np.float64]) -> View:
        """The view of the vehicle once its pose is corrected."""
        return replace(self.view, viewmat=self.view.viewmat @ torch.from_numpy(old_from_new).float())


def find_sights(scene: Scene, background: Frozen, insertion: Insertion, recipe: Recipe, threads: int) -> list[Sight]:
    """The frames that show the vehicle, camera by camera, in order of time.

    Raises `InputError` where no frame does.
    """

    def look(place: tuple[int, Frame]) -> Sight | None:
        position, frame = place
        held_out = position % HOLD_OUT_EVERY == HOLD_OUT_AT
        return _sight(frame, held_out, scene, background, insertion, recipe)

    places = [place for frames in scene.frames.values() for place in enumerate(frames)]
    with ThreadPoolExecutor(threads) as pool:
        sights = [sight for sight in pool.map(look, places) if sight is not None]
    if not sights:
        raise InputError(
            f"no frame of '{scene.name}' shows the vehicle: it is behind the cameras, outside their images, "
            "or out of the frames' time; check the trajectory and the choice of cameras and frames"
        )
    if all(sight.held_out for sight in sights):
        sights = [replace(sight, held_out=False) for sight in sights]
    return sights


def _sight(frame, held_out, scene, background, insertion, recipe) -> Sight | None:
    is_generated = frame.load_reactive_mask is not None
    moment = frame.camera.time
    if is_generated:
        insertion.trajectory.require(moment)
    elif not insertion.trajectory.covers(moment):
        return None
    world_from_vehicle = insertion.trajectory.at(moment)
    refined = background.camera(frame)
    camera = frame.camera if is_generated else refined
    if not visible_fraction(camera, world_from_vehicle, insertion) > recipe.visible:
        return None
    tracks = background.unexplained(scene.tracks, moment)
    region = find_region(frame, camera, world_from_vehicle, insertion, tracks)
    if region is None:
        return None
    return Sight(frame, camera, refined, world_from_vehicle, region, held_out)


def prepare_shots(
    sights: list[Sight],
    scene: Scene,
    background: Frozen,
    insertion: Insertion,
    bounds: NDArray[np.float64],
    threads: int,
    refines_poses: bool = False,
    deadline: float = math.inf,
) -> Generator[Preparing, None, list[Shot]]:
    """Load the pixels of every sight and split its background about ``bounds`` [2, 3] of the vehicle.

    Of the first sights only, but of `ENOUGH`, where a ``deadline`` [s] of the monotonic clock passes meanwhile.
    """
    sweeps = {sweep.frame_index: sweep for sweep in scene.sweeps}

    def prepare(sight: Sight) -> Shot:
        region, window = sight.region, sight.region.window
        view = View.from_camera(window.camera(sight.camera), sight.world_from_vehicle)
        is_generated = sight.frame.load_reactive_mask is not None
        interval = depth_interval(
            sight.camera.camera_from_world @ sight.world_from_vehicle,
            bounds,
            POSE_SLACK if refines_poses else 0.0,
        )
        background_camera = window.camera(sight.background_camera)
        frozen = background.freeze(background_camera, sight.frame.camera_name, interval)
        pixels = window.of(sight.frame.pixels).copy()
        alone = frozen.alone(View.from_camera(background_camera)).movedim(-1, 0)
        shown = torch.from_numpy(pixels).movedim(-1, 0).contiguous() / 255  # plane by plane, as the renderer stores
        target = torch.where(torch.from_numpy(region.bare), alone, shown)
        sweep, lidar = sweeps.get(sight.frame.index), None
        if sweep is not None and is_generated:
            lidar = static_depths(sweep, sight.background_camera, region)
        elif sweep is not None:
            lidar = carried_depths(sweep, sight.camera, sight.world_from_vehicle, insertion, region)
        return Shot(
            sight,
            view,
            frozen,
            pixels,
            target.movedim(0, -1),
            torch.from_numpy((region.supervised | region.bare).astype(np.float32)),
            lidar,
        )

    shots: list[Shot] = []
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(prepare, sight) for sight in sights]
        for future in futures:
            shots.append(future.result())
            yield Preparing("background layers", len(shots), len(sights))
            if time.monotonic() > deadline and len(shots) >= ENOUGH:
                pool.shutdown(cancel_futures=True)
                break
    return shots
