"""StreetCrafter's way: LiDAR points of the whole street tell of every pixel, and every pixel may be painted."""

from dataclasses import replace
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera, Frame, InputError, LidarSweep, Scene
from dwgs.scene.moving import is_there, static_points
from dwgs.scene.silhouette import NEAR
from dwgs.scene.trajectory import Trajectory
from generator.conditions.aggregate import SIMULTANEOUS, WINDOW, points_of_track
from generator.conditions.conditions import ConditionFrame, Conditions
from generator.conditions.raster import PointRasterizer, blend
from generator.long_video import CLIP

CELL = 4
"""Points are hidden by nearer ones within cells of so many pixels."""
HIDDEN = 1.15
"""A point so many times farther than the nearest one of its cell is hidden: the ground in a cell spans less."""

Pixels = tuple[NDArray[np.float32], NDArray[np.float32]]
"""(u, v, depth) [P, 3] and colours [P, 3]."""


def whole_frame(conditions: Conditions, street: "StreetPoints | None" = None) -> Conditions:
    """The same drive and vehicle, the whole of every image to be painted and told of by LiDAR points.

    In each frame, the points of the street from a second of sweeps before and after, those of the moving traffic,
    each carried by its box, and the inserted vehicle's are drawn together as discs (Yan et al., StreetCrafter,
    arXiv 2412.13188). Frames are drawn when they are asked for.

    Args:
        conditions: Of the vehicle's region alone.
        street: The points of the drive; by default they are gathered anew.

    Raises:
        InputError: The drive has no LiDAR.
    """
    require_lidar(conditions.scene)
    street = street or StreetPoints(conditions.scene)
    vehicle, way = PointRasterizer(conditions.insertion.vehicle), conditions.insertion.trajectory
    frames = {(f.camera_name, f.index): f for f in conditions.scene.all_frames()}

    @lru_cache(CLIP)  # the images of a clip are read before its masks
    def drawn(camera_name: str, index: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        frame = frames[camera_name, index]
        return street.draw(frame, vehicle.visible(frame.camera, way.at(frame.camera.time)))

    def told(condition: ConditionFrame) -> ConditionFrame:
        frame = condition.frame
        key = frame.camera_name, frame.index
        return ConditionFrame(
            frame,
            lambda: drawn(*key)[0].copy(),
            lambda: drawn(*key)[1].copy(),
            partial(np.ones, (frame.camera.height, frame.camera.width), bool),
        )

    return replace(conditions, frames={name: tuple(map(told, fs)) for name, fs in conditions.frames.items()})


def require_lidar(scene: Scene) -> None:
    """Raise `InputError` unless a drive has sweeps to draw."""
    if not scene.sweeps:
        raise InputError(f"whole frames are drawn from LiDAR sweeps, '{scene.name}' has none; leave --whole-frame out")


class StreetPoints:
    """What the LiDAR hit of a street and of its traffic, coloured by the images of the same time.

    Points of a sweep are coloured when a frame needs them, and kept.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._colored = lru_cache(None)(self._color)

    def draw(self, frame: Frame, vehicle: Pixels) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Point image [H, W, 3] and point mask [H, W] of a frame, with a vehicle's points among the others."""
        camera, parts = frame.camera, [vehicle]
        for number, sweep in enumerate(self._scene.sweeps):
            if abs(sweep.frame_index - frame.index) <= WINDOW:
                points, colors = self._colored(number)
                pixels, inside = _project(camera, points)
                parts.append((pixels[inside], colors[inside]))
        for rasterizer, way in self._movers:
            if is_there(way, camera.time):
                parts.append(rasterizer.visible(camera, way.at(camera.time)))
        pixels, colors = (np.concatenate(part) for part in zip(*parts, strict=True))
        shown = _is_shown(camera, pixels, pixels)
        return blend(camera, pixels[shown], colors[shown])

    @cached_property
    def _movers(self) -> list[tuple[PointRasterizer, Trajectory]]:
        """The traffic that the LiDAR saw enough of."""
        movers = []
        for track in self._scene.tracks:
            if track.is_moving:
                try:
                    vehicle, _ = points_of_track(self._scene, track)
                except InputError:  # hardly hit: nothing tells of it
                    continue
                movers.append((PointRasterizer(vehicle), track.trajectory))
        return movers

    def _color(self, number: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Points [P, 3] of the street that a sweep hit and an image of that time shows, with its colours [P, 3]."""
        sweep = self._scene.sweeps[number]
        points = static_points(self._scene, sweep)
        colors = np.full(points.shape, np.nan, np.float32)
        for frames in self._scene.frames.values():
            frame = min(frames, key=lambda f: abs(f.camera.time - sweep.time))
            if abs(frame.camera.time - sweep.time) < SIMULTANEOUS:
                bare = np.isnan(colors[:, 0])
                colors[bare] = _colors_in(frame, points[bare], sweep)
        known = np.isfinite(colors[:, 0])
        return points[known], colors[known]


def _colors_in(frame: Frame, points: NDArray[np.float32], sweep: LidarSweep) -> NDArray[np.float32]:
    """Colours [P, 3] of a frame at ``points`` [P, 3], NaN where it does not see them, or sees what is before them."""
    colors = np.full(points.shape, np.nan, np.float32)
    pixels, inside = _project(frame.camera, points)
    hit = sweep.points[np.isfinite(sweep.points).all(1)]
    all_pixels, all_inside = _project(frame.camera, hit)
    inside[inside] = _is_shown(frame.camera, pixels[inside], all_pixels[all_inside])
    column, row = pixels[inside, :2].astype(np.int64).T
    colors[inside] = frame.pixels[row, column]
    return colors


def _is_shown(camera: Camera, pixels: NDArray[np.float32], others: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which of (u, v, depth) [P, 3] no other [Q, 3] hides: the LiDAR looks past what hides a point from the camera."""
    nearest = np.full((camera.height // CELL + 1, camera.width // CELL + 1), np.inf, np.float32)
    column, row = (others[:, :2] / CELL).astype(np.int64).T
    np.minimum.at(nearest, (row, column), others[:, 2])
    column, row = (pixels[:, :2] / CELL).astype(np.int64).T
    return pixels[:, 2] <= HIDDEN * nearest[row, column]


def _project(camera: Camera, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(u, v, depth) [P, 3] of points in the world, and which lie in the image [P]."""
    uv, depth = camera.project(points)
    pixels = np.concatenate([uv, depth[:, None]], 1).astype(np.float32)
    return pixels, (depth > NEAR) & camera.contains(pixels[:, :2])
