"""Which Gaussians touch which tile."""

from dataclasses import dataclass
from typing import Any

import warp as wp
from torch import Tensor

from dwgs.splat.kernels.bins import Bins


@dataclass(frozen=True)
class Binned:
    """Intersections of Gaussians with tiles."""

    ends: Tensor
    """[V N] running count of intersections by Gaussian, view by view: those of one lie side by side."""
    gaussian_from_isect: Tensor
    """[M]."""
    isect_from_sorted: Tensor
    """[M] tile by tile, each nearest first."""
    ranges: Tensor
    """[tiles, 2] span of each tile in the sorted order."""

    def to_warp(self) -> Any:
        """The same arrays for the kernels."""
        bins = Bins()
        bins.ranges = wp.from_torch(self.ranges, dtype=wp.vec2i)
        bins.isect_from_sorted = wp.from_torch(self.isect_from_sorted)
        bins.gaussian_from_isect = wp.from_torch(self.gaussian_from_isect)
        return bins
