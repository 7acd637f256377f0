"""Where an inserted vehicle drives when nobody drew its trajectory."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.ground import Ground
from dwgs.scene.path import Path
from dwgs.scene.pose import pose
from dwgs.scene.scene import Scene
from dwgs.scene.trajectory import Trajectory

_WHEELS = np.array([[0.3, 0.4], [0.3, -0.4], [-0.3, 0.4], [-0.3, -0.4]])
"""Where the wheels of any vehicle stand, as fractions of its length and width."""
_SUSPENSION = np.linspace(-1, 1, 5)
"""Metres before and behind a wheel over which it feels the ground: tyres and springs even it out."""


def place_ahead(scene: Scene, size: ArrayLike, ahead: float, left: float, speed: float | None) -> Trajectory:
    """A vehicle on the ego's own path, wheels on the ground, at the times of all frames of the scene.

    At the first frame it is ``ahead`` metres further along the path than the ego, ``left`` metres beside it.
    From there it drives ``speed`` [m/s] along the path, or keeps its distance to the ego where ``speed`` is
    None. The path goes on straight beyond both ends. ``size`` is (length, width, height) [m]. Raises
    `InputError` where the scene has no LiDAR to find the ground in.
    """
    ground = Ground.from_sweeps(scene.sweeps, scene.ego)
    path = Path.of(scene.ego)
    times = np.unique([frame.camera.time for frame in scene.all_frames()])
    driven = np.maximum.accumulate(path.locate(scene.ego.at(times)[:, :2, 3]))
    start = driven if speed is None else driven[0] + speed * (times - times[0])
    xy, heading = path.at(start + ahead, left)
    return Trajectory(times, stand_on(ground, xy, heading, size))


def stand_on(ground: Ground, xy: ArrayLike, heading: ArrayLike, size: ArrayLike) -> NDArray[np.float64]:
    """``world_from_vehicle`` [T, 4, 4] of a box over world positions [T, 2], its four wheels on the ground.

    Pitch and roll are those of the plane that fits the ground under the wheels best; ``heading`` [T] [rad] is
    kept.
    """
    xy, heading = np.asarray(xy, np.float64), np.asarray(heading, np.float64)
    length, width, height = np.asarray(size, np.float64)
    forward = np.stack([np.cos(heading), np.sin(heading)], -1)
    left = np.stack([-np.sin(heading), np.cos(heading)], -1)
    wheels = _WHEELS * (length, width)
    along = wheels[:, 0, None] + _SUSPENSION
    under = xy[:, None, None] + along[..., None] * forward[:, None, None]
    under = under + (wheels[:, 1, None, None] * left[:, None, None])
    z = ground.height(under).mean(-1)  # [T, wheel]
    slope_forward = z @ wheels[:, 0] / (wheels[:, 0] ** 2).sum()
    slope_left = z @ wheels[:, 1] / (wheels[:, 1] ** 2).sum()

    x_axis = np.concatenate([forward, slope_forward[:, None]], -1)
    x_axis /= np.linalg.norm(x_axis, axis=-1, keepdims=True)
    z_axis = np.cross(x_axis, np.concatenate([left, slope_left[:, None]], -1))
    z_axis /= np.linalg.norm(z_axis, axis=-1, keepdims=True)
    rotation = np.stack([x_axis, np.cross(z_axis, x_axis), z_axis], -1)
    contact = np.concatenate([xy, z.mean(-1)[:, None]], -1)
    return pose(rotation, contact + height / 2 * z_axis)


def conflicts(scene: Scene, size: ArrayLike, trajectory: Trajectory) -> list[tuple[str, int, int]]:
    """Recorded tracks whose boxes, seen from above, overlap the vehicle's: (id, first frame, last frame).

    Frames are the main camera's. ``size`` is the vehicle's (length, width, height) [m]; only times that both
    trajectories cover count.
    """
    frames = scene.frames[scene.main_camera]
    times = np.array([frame.camera.time for frame in frames])
    covered = trajectory.covers(times)
    vehicle = trajectory.at(times)
    found = []
    for track in scene.tracks:
        both = np.flatnonzero(covered & track.trajectory.covers(times))
        hit = both[_overlap(vehicle[both], np.asarray(size), track.trajectory.at(times[both]), track.size)]
        if len(hit):
            found.append((track.id, frames[hit[0]].index, frames[hit[-1]].index))
    return found


def _overlap(world_from_a: NDArray, size_a: NDArray, world_from_b: NDArray, size_b: NDArray) -> NDArray[np.bool_]:
    """Whether rectangles [T] overlap: no side of either separates them (separating axis theorem)."""
    axes_a, axes_b = world_from_a[:, :2, :2], world_from_b[:, :2, :2]
    between = world_from_b[:, :2, 3] - world_from_a[:, :2, 3]
    overlap = np.ones(len(between), bool)
    for axes in (axes_a, axes_b):
        for k in (0, 1):
            axis = axes[:, :, k]
            reach_a = abs(np.einsum("ti,tik->tk", axis, axes_a)) @ size_a[:2] / 2
            reach_b = abs(np.einsum("ti,tik->tk", axis, axes_b)) @ size_b[:2] / 2
            overlap &= abs((axis * between).sum(1)) <= reach_a + reach_b
    return overlap
