"""Who drives where: the recording car, the traffic, and the vehicle to be inserted."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.pose import pose, yaw_rotation
from dwgs.scene.trajectory import Trajectory
from dwgs.street.road import LANE

PERIOD = 0.1
"""Time between frames, and of one turn of the LiDAR [s]."""
SPEED = 7.0
"""Pace of the recording car [m/s]."""


def key_times(frames: int) -> NDArray[np.float64]:
    """Times of key poses [s]: from the start of the first sweep to the end of the last, two per frame."""
    return (PERIOD / 2) * np.arange(2 * frames + 1, dtype=np.float64)


def along_path(times: NDArray, x: ArrayLike, y: ArrayLike, z: float, oncoming: bool = False) -> Trajectory:
    """A drive through (x, y) at each time, heading where it goes, at a constant height."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    x, y = x + np.zeros(len(times)), y + np.zeros(len(times))
    dx, dy = np.gradient(x, times), np.gradient(y, times)
    is_still = np.hypot(dx, dy) < 1e-3
    yaw = np.where(is_still, np.pi if oncoming else 0.0, np.arctan2(dy, dx))
    return Trajectory(times, pose(yaw_rotation(yaw), np.stack([x, y, np.full(len(times), z)], -1)))


def ego_x(times: ArrayLike) -> NDArray[np.float64]:
    """Way of the recording car along the road [m]."""
    times = np.asarray(times, np.float64)
    return SPEED * times + 0.6 * (1 - np.cos(0.7 * times))


def ego_trajectory(frames: int, rng: np.random.Generator) -> Trajectory:
    """The recording car in its lane: it sways a little and nods a little; the origin is on the ground."""
    times = key_times(frames)
    phase = rng.uniform(0, 2 * np.pi, 3)
    y = 0.10 * (np.sin(0.8 * times + phase[0]) - np.sin(phase[0]))
    path = along_path(times, ego_x(times), y, 0.0)
    nod = 0.0025 * np.sin(3.1 * times + phase[1])
    roll = 0.0020 * np.sin(2.3 * times + phase[2])
    one, zero = np.ones_like(nod), np.zeros_like(nod)
    small = np.stack([one, zero, nod, zero, one, -roll, -nod, roll, one], -1).reshape(-1, 3, 3)
    u, _, vt = np.linalg.svd(small)
    return Trajectory(times, path.world_from_vehicle @ pose(u @ vt, np.zeros((len(times), 3))))


def lead_trajectory(frames: int, height: float) -> Trajectory:
    """A car far ahead in the ego lane."""
    times = key_times(frames)
    return along_path(times, ego_x(times) + 33 + 2.5 * np.sin(0.35 * times), 0.0, height / 2)


def oncoming_trajectory(frames: int, height: float, start: float, speed: float) -> Trajectory:
    """A car that comes towards us in the far lane, from x = start [m]."""
    times = key_times(frames)
    return along_path(times, start - speed * times, 2 * LANE, height / 2, oncoming=True)


def inserted_trajectory(frames: int, height: float) -> Trajectory:
    """Alongside in the left lane, then 17 m ahead, then in the ego lane: seen from side to rear."""
    times = key_times(frames)
    s = times / times[-1]
    ahead = 9.0 - 1.2 * _ease(s, 0.0, 0.25) + 10.5 * _ease(s, 0.25, 0.62)
    left = LANE * (1 - _ease(s, 0.52, 0.78))
    return along_path(times, ego_x(times) + ahead, left, height / 2)


def _ease(s: NDArray, low: float, high: float) -> NDArray:
    t = np.clip((s - low) / (high - low), 0, 1)
    return t * t * t * (10 - 15 * t + 6 * t * t)
