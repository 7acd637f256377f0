"""A vehicle's surface as its file describes it, before anybody knows its units and axes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Convention:
    """How a file measures: which unit, which axis is up, which is forward."""

    unit: str
    """One of `UNITS`."""
    up: str
    """One of `AXES`."""
    forward: str
    """One of `AXES`, at right angles to ``up``."""


@dataclass(frozen=True)
class Surface:
    """Points in the file's own frame and unit."""

    points: NDArray[np.float64]
    """[P, 3]."""
    colors: NDArray[np.uint8]
    """[P, 3] sRGB."""
    normals: NDArray[np.float64] | None = None
    """[P, 3] unit, of either sign; None for a scan without them."""
    triangles: NDArray[np.float64] | None = None
    """[F, 3, 3] corners; None for a cloud."""
    face: NDArray[np.int64] | None = None
    """[P] the triangle that each point lies on; None for a cloud."""
    stated: Convention | None = None
    """What the format states."""
    remarks: tuple[str, ...] = ()
    """What a person should know, in a few words each."""


UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "feet": 0.3048}
"""Metres in each unit, in the order in which they are tried."""

AXES = {
    "x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1),
}  # fmt: skip
"""Direction of each axis name."""
