"""The street as a recorded drive, and the same drive with a vehicle that is truly there."""

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dwgs.scene import (
    Camera,
    Frame,
    InputError,
    Insertion,
    LidarSweep,
    Scene,
    Track,
    Trajectory,
    VehiclePoints,
)
from dwgs.scene.pose import pose
from dwgs.street import kernels
from dwgs.street.car import sample_surface
from dwgs.street.drive import PERIOD, ego_trajectory, inserted_trajectory
from dwgs.street.lidar import take_sweep
from dwgs.street.oracle import Oracle
from dwgs.street.plan import Plan, Vehicle, draw_plan
from dwgs.street.render import render, render_depth
from dwgs.street.world import Stage, build_stage

CAMERA = "front"
"""The street is recorded by one camera."""
EGO_FROM_CAMERA = pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (1.3, 0.0, 1.6))
"""Behind the windscreen, level."""
FOCAL = 620 / 720
"""Focal length over image width."""
VEHICLE_POINTS = 250_000
"""About 1 cm apart."""
SUN_ELEVATION, SUN_AZIMUTH = np.radians(47.0), np.radians(143.0)
"""Behind the recording car to the left: it lights the rear of what drives ahead and the right-hand houses."""


@dataclass(frozen=True)
class Street:
    """A street about which everything is known. Pixels are rendered when first asked for, then kept."""

    frames: int
    """Length of the recording, at 10 Hz."""
    width: int
    """Image width [px]."""
    height: int
    """Image height [px]."""
    seed: int
    """Of everything drawn by lot."""
    plan: Plan = field(repr=False)
    """What stands where."""
    stage: Stage = field(repr=False)
    """The same, ready for rays."""
    ego: Trajectory = field(repr=False)
    """The recording car; its origin is on the ground."""
    _kept: dict[int, NDArray[np.uint8]] = field(default_factory=dict, repr=False, compare=False)

    def camera(self, index: int) -> Camera:
        """The camera of a frame: it exposes in the middle of the frame's sweep, which then looks ahead."""
        focal = FOCAL * self.width
        K = np.array([[focal, 0, self.width / 2], [0, focal, self.height / 2], [0, 0, 1.0]])
        time = (index + 0.5) * PERIOD
        return Camera(K, self.width, self.height, self.ego.at(time) @ EGO_FROM_CAMERA, time)

    def pixels(self, index: int, executor: Executor | None = None) -> NDArray[np.uint8]:
        """A recorded frame [H, W, 3] sRGB, without any noise."""
        if index not in self._kept:
            self._kept[index] = render(self.stage, self.camera(index), executor=executor).pixels
        return self._kept[index].copy()

    def depth(self, index: int) -> NDArray[np.float32]:
        """z-depth [H, W] [m] of a recorded frame at its pixel centres, infinite in the sky."""
        return render_depth(self.stage, self.camera(index))

    def render_all(self, on_progress: Callable[[int, int], None] | None = None, threads: int = 2) -> None:
        """Renders every frame now, one per thread."""
        with ThreadPoolExecutor(threads) as executor:
            for done, _ in enumerate(executor.map(self.pixels, range(self.frames)), 1):
                if on_progress:
                    on_progress(done, self.frames)

    def scene(self) -> Scene:
        """The recorded drive."""
        frames = tuple(
            Frame(index, CAMERA, self.camera(index), partial(self.pixels, index)) for index in range(self.frames)
        )
        return Scene(f"street-{self.seed}", {CAMERA: frames}, self.ego, self._sweeps, self._tracks)

    @cached_property
    def _sweeps(self) -> tuple[LidarSweep, ...]:
        with ThreadPoolExecutor(2) as executor:
            jobs = [executor.submit(take_sweep, self.stage, self.ego, i, self.seed) for i in range(self.frames)]
            return tuple(job.result() for job in jobs)

    @property
    def _tracks(self) -> tuple[Track, ...]:
        def tracks(kind: str, vehicles: tuple[Vehicle, ...], is_moving: bool) -> Iterator[Track]:
            for k, v in enumerate(vehicles):
                yield Track(f"{kind}-{k:02d}", "Car", np.array(v.size), v.trajectory, is_moving)

        return (*tracks("moving", self.plan.movers, True), *tracks("parked", self.plan.parked, False))

    @cached_property
    def vehicle(self) -> tuple[VehiclePoints, NDArray[np.float64]]:
        """The vehicle to be inserted, as points on its surface, and its size [3] [m]."""
        hero = self.plan.hero
        return sample_surface(hero.shape, self.plan.palette, VEHICLE_POINTS, self.seed), np.array(hero.size)

    def insertion(self) -> Insertion:
        """The vehicle alongside in the left lane, then ahead, then in the ego lane."""
        points, size = self.vehicle
        return Insertion(points, size, inserted_trajectory(self.frames, size[2]))

    def oracle(self, insertion: Insertion) -> Scene:
        """The drive with the true vehicle, its true light and shadow, and exact reactive masks."""
        oracle = Oracle(self.pixels, self.camera, self.with_vehicle(insertion.trajectory))
        scene = self.scene()
        insertion.trajectory.require([frame.camera.time for frame in scene.frames[CAMERA]])
        frames = tuple(
            replace(
                frame,
                load_pixels=partial(oracle.pixels, frame.index),
                load_reactive_mask=partial(oracle.reactive_mask, frame.index),
            )
            for frame in scene.frames[CAMERA]
        )
        return replace(scene, name=f"{scene.name}-oracle", frames={CAMERA: frames})

    def with_vehicle(self, trajectory: Trajectory) -> Stage:
        """The street with the true vehicle on this way, as its last body."""
        return self.stage.with_mover(replace(self.plan.hero, trajectory=trajectory))

    def view(self, camera: Camera, time: float, insertion: Insertion | None = None) -> "View":
        """What any camera sees at a time [s], with the true vehicle where there is an insertion."""
        stage = self.with_vehicle(insertion.trajectory) if insertion else self.stage
        return _view(stage, replace(camera, time=time), -1, insertion is not None)

    def vehicle_view(self, camera: Camera, insertion: Insertion, time: float) -> "View":
        """The true vehicle alone on grey 127, lit and shaded as in the street at that time [s]."""
        stage = self.with_vehicle(insertion.trajectory)
        return _view(stage, replace(camera, time=time), len(stage.shapes) - 1, True)


@dataclass(frozen=True)
class View:
    """An image with its geometry."""

    rgb: NDArray[np.uint8]
    """[H, W, 3] sRGB."""
    depth: NDArray[np.float32]
    """[H, W] z-depth at the pixel centres [m], infinite where nothing is."""
    vehicle_alpha: NDArray[np.float32]
    """[H, W] share of the pixel that the inserted vehicle covers."""


def _view(stage: Stage, camera: Camera, only: int, has_vehicle: bool) -> View:
    picture = render(stage, camera, only)
    share = picture.share * np.float32(has_vehicle / 255)
    return View(picture.pixels, render_depth(stage, camera, only), share.astype(np.float32))


def build_street(
    seed: int = 0, frames: int = 193, width: int = 720, height: int = 480, sun_azimuth: float = SUN_AZIMUTH
) -> Street:
    """A street, the traffic in it, and a recording of so many frames at 10 Hz; nothing is rendered yet.

    The sun stands at ``sun_azimuth`` [rad], counted from ahead to the left. Raises `InputError` where a size is not
    positive.
    """
    if min(frames, width, height) < 1:
        raise InputError(f"a street has at least one frame and one pixel, got {frames} of {width}x{height}")
    wp.load_module(kernels, device="cpu", recursive=False)
    plan = draw_plan(seed, frames)
    flat = np.cos(SUN_ELEVATION)
    sun = np.array([flat * np.cos(sun_azimuth), flat * np.sin(sun_azimuth), np.sin(SUN_ELEVATION)])
    stage = build_stage(plan, sun, seed)
    return Street(frames, width, height, seed, plan, stage, ego_trajectory(frames, np.random.default_rng((seed, 3))))
