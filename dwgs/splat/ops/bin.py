"""Records to tiles. Nothing here is differentiable; the adjoint of compositing reuses it."""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from dwgs.splat.kernels import bin as kernels
from dwgs.splat.kernels.project import record12
from dwgs.splat.parallel import launch
from dwgs.splat.splats import View

_EMPTY_TILE = 4
"""Work of a tile without Gaussians, in intersections."""


@dataclass(frozen=True)
class Binned:
    """Intersections of Gaussians with tiles."""

    gaussian_from_rank: Tensor
    """[N] Gaussians in order of depth."""
    ends: Tensor
    """[N] running count of intersections by rank: those of one Gaussian lie side by side."""
    gaussian_from_isect: Tensor
    """[M]."""
    isect_from_sorted: Tensor
    """[M] tile by tile, each nearest first."""
    ranges: Tensor
    """[tiles, 2] span of each tile in the sorted order."""

    def chunks(self, count: int) -> list[int]:
        """Bounds of ``count`` runs of tiles that hold about equal work."""
        work = (self.ranges[:, 1] - self.ranges[:, 0] + _EMPTY_TILE).cumsum(0)
        shares = torch.arange(1, count) * (int(work[-1]) / count)
        return [0, *torch.searchsorted(work, shares).tolist(), len(work)]

    def to_warp(self) -> kernels.Bins:
        """The same arrays for the compositing kernels."""
        bins = kernels.Bins()
        bins.ranges = wp.from_torch(self.ranges, dtype=wp.vec2i)
        bins.isect_from_sorted = wp.from_torch(self.isect_from_sorted)
        bins.gaussian_from_isect = wp.from_torch(self.gaussian_from_isect)
        return bins


def bin(records: Tensor, view: View, threads: int) -> Binned:
    """Sort the records [N, 12] by depth, cut them by tile."""
    n = len(records)
    device, where = wp.device_from_torch(records.device), records.device
    tiles_across, tiles_down = view.tiles
    tiles = wp.vec2i(tiles_across, tiles_down)
    integer = {"dtype": torch.int32, "device": where}
    warp_records = wp.from_torch(records, dtype=record12, return_ctype=True)

    keys = wp.from_torch(torch.empty(2 * n, device=where))
    ranked = torch.empty(2 * n, **integer)
    gaussian_from_rank = wp.from_torch(ranked)
    launch(kernels.depth_keys, n, [warp_records, keys, gaussian_from_rank], device, threads)
    wp.utils.radix_sort_pairs(keys, gaussian_from_rank, n)

    ends = torch.empty(n, **integer)
    warp_ends = wp.from_torch(ends)
    launch(kernels.count_tiles, n, [warp_records, gaussian_from_rank, tiles, warp_ends], device, threads)
    wp.utils.array_scan(warp_ends, warp_ends, inclusive=True)
    m = int(ends[-1]) if n else 0

    tile_keys = wp.from_torch(torch.empty(2 * m, **integer))
    sorted_isects = torch.empty(2 * m, **integer)
    warp_isects = wp.from_torch(sorted_isects)
    gaussian_from_isect = torch.empty(m, **integer)
    out = [tile_keys, warp_isects, wp.from_torch(gaussian_from_isect)]
    launch(kernels.emit, n, [warp_records, gaussian_from_rank, warp_ends, tiles, *out], device, threads)
    wp.utils.radix_sort_pairs(tile_keys, warp_isects, m, 0, (tiles_across * tiles_down - 1).bit_length())

    ranges = torch.zeros(tiles_across * tiles_down, 2, **integer)
    inputs = [tile_keys, m, wp.from_torch(ranges, dtype=wp.vec2i)]
    launch(kernels.find_ranges, m, inputs, device, threads)
    return Binned(ranked[:n], ends, gaussian_from_isect, sorted_isects[:m], ranges)
