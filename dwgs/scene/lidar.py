"""One turn of a LiDAR."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LidarSweep:
    """Returns of one sweep, already in the world."""

    points: NDArray[np.float32]
    """[P, 3] world [m]."""
    times: NDArray[np.float64]
    """[P] when each point was hit [s]."""
    origin: NDArray[np.float64]
    """[3] the sensor in the world at the end of the sweep [m]."""
    time: float
    """End of the sweep [s]."""
    frame_index: int
    """The recording's frame this sweep belongs to."""
    labels: NDArray[np.uint8] | None = None
    """[P] one of `SURFACES` by index, where the recording says."""


SURFACES = ("unknown", "ground", "static", "vehicle", "person", "noise")
"""What a point lies on, as far as any stage asks: `noise` is exhaust, spray and mirror images."""
