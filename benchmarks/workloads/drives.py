"""Ways that a vehicle takes through the embedded street, beside the one it knows itself."""

from dataclasses import replace

import numpy as np

from dwgs.scene import Insertion, Trajectory
from dwgs.street import Street
from dwgs.street.drive import along_path, ego_x, key_times
from dwgs.street.road import LANE

PARKED_AHEAD = 12.0
"""Where the recording car passes what is parked, short of half its own way [m]."""


def inserted(street: Street, drive: str) -> Insertion:
    """The street's vehicle on the way of that name: street, near, far, overtaking or parked."""
    insertion = street.insertion()
    if drive == "street":
        return insertion
    return replace(insertion, trajectory=_trajectory(drive, street.frames, float(insertion.size[2])))


def _trajectory(drive: str, frames: int, height: float) -> Trajectory:
    """In the left lane all of them, so that no recorded car stands before it."""
    times = key_times(frames)
    ego, share = ego_x(times), times / times[-1]
    ways = {
        "near": ego + 8.5 + 0.8 * np.sin(2 * np.pi * share),
        "far": ego + 40.0 + 40.0 * share,
        "overtaking": ego - 8.0 + 43.0 * share,
        "parked": np.full(len(times), ego[len(ego) // 2] + PARKED_AHEAD),
    }
    return along_path(times, ways[drive], LANE, height / 2)
