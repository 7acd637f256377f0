"""What moves in a recorded drive, and what the LiDAR says about the street itself."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.lidar import SURFACES, LidarSweep
from dwgs.scene.pose import inverse
from dwgs.scene.scene import Scene
from dwgs.scene.track import Track
from dwgs.scene.trajectory import Trajectory

BODY_MARGIN = 0.25
"""Boxes are annotated by hand and mirrors stick out: grown by this much on every side [m]."""
TIME_SLACK = 0.15
"""A camera may fire shortly before the first or after the last annotation of a vehicle it sees [s]."""
FLEETING = [SURFACES.index("person"), SURFACES.index("noise")]
"""Labels of points that are not there in the next frame."""


def moving_tracks(scene: Scene, time: float) -> list[Track]:
    """Tracks that ever move and are recorded at this time [s]."""
    return [track for track in scene.tracks if track.is_moving and is_there(track.trajectory, time)]


def is_there(trajectory: Trajectory, time: float) -> bool:
    """Whether a recorded vehicle may be seen at this time [s]."""
    return bool(trajectory.times[0] - TIME_SLACK <= time <= trajectory.times[-1] + TIME_SLACK)


def static_points(scene: Scene, sweep: LidarSweep) -> NDArray[np.float32]:
    """Points [P, 3] of a sweep in the world that lie on nothing that moves."""
    kept = np.isfinite(sweep.points.sum(1))
    if sweep.labels is not None:
        kept &= ~np.isin(sweep.labels, FLEETING)
    for track in moving_tracks(scene, sweep.time):
        kept[hits_in_box(sweep, track, kept)[0]] = False
    return sweep.points[kept]


def hits_in_box(
    sweep: LidarSweep, track: Track, candidates: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which of the ``candidates`` [P] of a sweep lie in a track's box, each at its own time, and where in its frame.

    The box is grown by `BODY_MARGIN`; indices [I], points [I, 3] [m].
    """
    half = track.size / 2 + BODY_MARGIN
    # A moving box sweeps over several metres in one turn: each point meets it at its own time.
    reach = np.linalg.norm(half) + 3.0
    centre = track.trajectory.at(sweep.time)[:3, 3]
    x, y = np.abs(sweep.points[:, :2].T - centre[:2, None])
    near = np.flatnonzero(candidates & (x < reach) & (y < reach))
    box_from_world = inverse(track.trajectory.at(sweep.times[near]))
    local = (box_from_world[:, :3, :3] @ sweep.points[near, :, None])[..., 0] + box_from_world[:, :3, 3]
    inside = (np.abs(local) < half).all(1)
    return near[inside], local[inside]
