"""What to put where: the one thing a user authors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.trajectory import Trajectory


@dataclass(frozen=True)
class VehiclePoints:
    """The surface of a vehicle as coloured points in its own frame: box centre, x forward, y left, z up."""

    points: NDArray[np.float32]
    """[P, 3] [m]."""
    colors: NDArray[np.uint8]
    """[P, 3] sRGB."""
    normals: NDArray[np.float32] | None = None
    """[P, 3] unit, outward, where the source knows them (a mesh does, a scan does not)."""
    is_complete: bool = False
    """Whether every side is covered (a mesh) or only what a sensor saw (a scan)."""

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1:] != (3,) or len(self.points) == 0:
            raise InputError(f"a vehicle has at least one point [P, 3], got {self.points.shape}")
        if self.colors.shape != self.points.shape or self.colors.dtype != np.uint8:
            raise InputError(f"a vehicle has one uint8 colour per point, got {self.colors.dtype} {self.colors.shape}")
        if not np.isfinite(self.points).all():
            bad = int((~np.isfinite(self.points).all(1)).sum())
            raise InputError(f"points of a vehicle are finite, {bad} of {len(self.points)} are not; remove them")
        if self.normals is not None and self.normals.shape != self.points.shape:
            raise InputError(f"a vehicle has one normal per point or none, got {self.normals.shape}")


@dataclass(frozen=True)
class Insertion:
    """A vehicle on its way through the scene."""

    vehicle: VehiclePoints
    """Its surface, in its own frame."""
    size: NDArray[np.float64]
    """[3] (length, width, height) of the box [m]; wheels touch the ground at z = -height / 2."""
    trajectory: Trajectory
    """Pose of the box centre."""
    category: str = "car"
    """Class of vehicle."""


def box_corners(size: NDArray) -> NDArray[np.float64]:
    """The eight corners [8, 3] [m] of a box of (length, width, height) about the origin."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    return signs * np.asarray(size, np.float64) / 2
