"""A vehicle that the recording saw."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.trajectory import Trajectory

MOVING_DISTANCE = 0.8
"""A track whose box centre strays further than this [m] moves; less is annotation jitter."""


@dataclass(frozen=True)
class Track:
    """A box through time."""

    id: str
    """Unique in the scene."""
    category: str
    """The recording's own class name."""
    size: NDArray[np.float64]
    """[3] (length, width, height) [m]."""
    trajectory: Trajectory
    """Pose of the box centre."""
    is_moving: bool
    """Whether it ever drives while recorded."""
    is_vehicle: bool = True
    """Rigid and on wheels: can be distilled. People are not."""
