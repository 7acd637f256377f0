"""A line on the ground, by the length driven along it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.trajectory import Trajectory

KNOT_SPACING = 2.0
"""Distance [m] between the positions that shape a path: closer ones would turn noise into heading."""

_STEP = 0.1


@dataclass(frozen=True)
class Path:
    """A smooth curve in the plane, straight beyond both ends."""

    s: NDArray[np.float64]
    """[N] length from the start [m], increasing."""
    xy: NDArray[np.float64]
    """[N, 2] world [m]."""
    heading: NDArray[np.float64]
    """[N] direction of travel [rad] about +z, without jumps of a full turn."""

    @staticmethod
    def of(trajectory: Trajectory) -> "Path":
        """The path a vehicle drove; where it stood, nothing but its heading counts.

        A cubic Hermite curve through positions `KNOT_SPACING` apart. At both ends it leaves in the direction
        the vehicle faces, which is known better there than the direction it moves in.
        """
        positions = trajectory.world_from_vehicle[:, :2, 3]
        knots = [0]
        for i in range(len(positions)):
            if np.linalg.norm(positions[i] - positions[knots[-1]]) >= KNOT_SPACING:
                knots.append(i)
        facing = trajectory.world_from_vehicle[[0, knots[-1]], :2, 0]
        facing = facing / np.linalg.norm(facing, axis=1, keepdims=True)
        if len(knots) == 1:
            return Path(np.zeros(1), positions[:1], np.arctan2(facing[:1, 1], facing[:1, 0]))
        points = positions[knots]
        chords = np.diff(points, axis=0)
        lengths = np.linalg.norm(chords, axis=1)
        tangents = np.empty_like(points)
        tangents[1:-1] = chords[:-1] / lengths[:-1, None] + chords[1:] / lengths[1:, None]
        tangents[[0, -1]] = facing
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)

        count = np.ceil(lengths / _STEP).astype(int)
        i = np.repeat(np.arange(len(chords)), count)
        u = np.concatenate([np.arange(n) / n for n in count])[:, None]
        start, end = lengths[i, None] * tangents[i], lengths[i, None] * tangents[i + 1]
        curve = points[i] + u**2 * (3 - 2 * u) * chords[i] + u * (1 - u) ** 2 * start - u**2 * (1 - u) * end
        xy = np.vstack([curve, points[-1:]])
        steps = np.diff(xy, axis=0)
        s = np.append(0, np.cumsum(np.linalg.norm(steps, axis=1)))
        middle = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        heading = np.interp(s, (s[1:] + s[:-1]) / 2, middle)
        return Path(s, xy, heading)

    @property
    def length(self) -> float:
        """From the first to the last position [m]."""
        return float(self.s[-1])

    def at(self, s: ArrayLike, left: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """World position [..., 2] [m] and heading [...] [rad] at length ``s`` [m], ``left`` metres beside."""
        s = np.asarray(s, np.float64)
        heading = np.interp(s, self.s, self.heading)
        forward = np.stack([np.cos(heading), np.sin(heading)], -1)
        normal = np.stack([-np.sin(heading), np.cos(heading)], -1)
        inside = np.clip(s, 0, self.length)
        xy = np.stack([np.interp(inside, self.s, self.xy[:, k]) for k in (0, 1)], -1)
        return xy + (s - inside)[..., None] * forward + left * normal, heading

    def locate(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Length [N] [m] along the path nearest to world positions [N, 2]."""
        xy = np.asarray(xy, np.float64)
        nearest = np.array([np.argmin(((self.xy - point) ** 2).sum(1)) for point in xy])
        heading = self.heading[nearest]
        beyond = xy - self.xy[nearest]
        return self.s[nearest] + beyond[:, 0] * np.cos(heading) + beyond[:, 1] * np.sin(heading)
