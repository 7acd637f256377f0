"""Where a vehicle is, and when."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.pose import is_rigid, pose, quat_from_rotation, rotation_from_quat, slerp

TIME_TOLERANCE = 1e-6
"""Slack [s] when asking whether a time is covered: stamps are stored rounded."""


@dataclass(frozen=True)
class Trajectory:
    """A rigid motion: straight lines and great arcs between key poses."""

    times: NDArray[np.float64]
    """[T] [s], strictly increasing."""
    world_from_vehicle: NDArray[np.float64]
    """[T, 4, 4] poses of the box centre, x forward, y left, z up [m]."""

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or len(self.times) < 1 or len(self.times) != len(self.world_from_vehicle):
            raise InputError(
                f"a trajectory has one pose per time, got {len(self.times)} times "
                f"and {len(self.world_from_vehicle)} poses"
            )
        if not np.isfinite(self.times).all() or (np.diff(self.times) <= 0).any():
            raise InputError("times of a trajectory are finite and strictly increasing; sort them, drop doubles")
        if not is_rigid(self.world_from_vehicle):
            raise InputError("every pose of a trajectory is a rotation and a translation of finite numbers")

    def covers(self, time: ArrayLike) -> NDArray[np.bool_]:
        """Whether each time [s] lies between the first and the last key pose."""
        time = np.asarray(time, np.float64)
        return (time >= self.times[0] - TIME_TOLERANCE) & (time <= self.times[-1] + TIME_TOLERANCE)

    def require(self, times: ArrayLike) -> None:
        """Raise `InputError` naming the first time [s] that is not covered."""
        times = np.atleast_1d(np.asarray(times, np.float64))
        missing = np.flatnonzero(~self.covers(times))
        if len(missing):
            raise InputError(
                f"trajectory covers {self.times[0]:.2f}-{self.times[-1]:.2f} s but frame {missing[0]} of the "
                f"clip is at {times[missing[0]]:.2f} s; trim the clip or extend the trajectory"
            )

    def at(self, time: ArrayLike) -> NDArray[np.float64]:
        """``world_from_vehicle`` [..., 4, 4] at the given times [s], held still beyond either end."""
        time = np.clip(np.asarray(time, np.float64), self.times[0], self.times[-1])
        if len(self.times) == 1:
            return np.broadcast_to(self.world_from_vehicle[0], (*time.shape, 4, 4)).copy()
        i = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        s = (time - self.times[i]) / (self.times[i + 1] - self.times[i])
        quat = slerp(self._quats[i], self._quats[i + 1], s)
        before, after = self.world_from_vehicle[i, :3, 3], self.world_from_vehicle[i + 1, :3, 3]
        return pose(rotation_from_quat(quat), before + s[..., None] * (after - before))

    def moved(self, world_from_world: NDArray[np.float64]) -> "Trajectory":
        """The same motion carried elsewhere by a rigid transform [4, 4] of the world."""
        return Trajectory(self.times, world_from_world @ self.world_from_vehicle)

    @cached_property
    def _quats(self) -> NDArray[np.float64]:
        """[T, 4] rotations."""
        return quat_from_rotation(self.world_from_vehicle[:, :3, :3])

    @property
    def length(self) -> float:
        """Distance driven [m]."""
        return float(np.linalg.norm(np.diff(self.world_from_vehicle[:, :3, 3], axis=0), axis=1).sum())

    def driven(self, time: ArrayLike, point: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
        """How far [...] [m] a ``point`` [3] of the vehicle has come forward since the first key pose.

        At the given times [s], held still beyond either end; what is driven backwards is taken off again.
        """
        places = self.world_from_vehicle[:, :3, :3] @ np.asarray(point, np.float64) + self.world_from_vehicle[:, :3, 3]
        ahead = self.world_from_vehicle[1:, :3, 0] + self.world_from_vehicle[:-1, :3, 0]
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        ways = np.cumsum((np.diff(places, axis=0) * ahead).sum(1))
        return np.interp(np.asarray(time, np.float64), self.times, np.append(0, ways))
