"""Records to tiles. Nothing here is differentiable; the adjoint of compositing reuses it."""

from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from dwgs.splat.kernels import bin as kernels
from dwgs.splat.kernels.project import record16
from dwgs.splat.ops.scratch import scratch
from dwgs.splat.parallel import launch
from dwgs.splat.splats import View

_EMPTY_TILE = 4
"""Work of a tile without Gaussians, in intersections."""


@dataclass(frozen=True)
class Binned:
    """Intersections of Gaussians with tiles."""

    gaussian_from_rank: Tensor
    """[V N] Gaussians in order of depth, counted view by view."""
    ends: Tensor
    """[V N] running count of intersections by rank: those of one Gaussian lie side by side."""
    gaussian_from_isect: Tensor
    """[M]."""
    isect_from_sorted: Tensor
    """[M] tile by tile, each nearest first."""
    ranges: Tensor
    """[tiles, 2] span of each tile in the sorted order."""

    def chunks(self, count: int) -> list[int]:
        """Bounds of ``count`` runs of tiles that hold about equal work."""
        work = (self.ranges[:, 1] - self.ranges[:, 0] + _EMPTY_TILE).cumsum(0)
        shares = torch.arange(1, count, device=work.device) * (int(work[-1]) / count)
        return [0, *torch.searchsorted(work, shares).tolist(), len(work)]

    def to_warp(self) -> Any:
        """The same arrays for the compositing kernels."""
        bins = kernels.Bins()
        bins.ranges = wp.from_torch(self.ranges, dtype=wp.vec2i)
        bins.isect_from_sorted = wp.from_torch(self.isect_from_sorted)
        bins.gaussian_from_isect = wp.from_torch(self.gaussian_from_isect)
        return bins


def bin(records: Tensor, view: View, capacity: int | None, threads: int) -> Binned:
    """Sort the records [V, N, 16] by depth, cut them by tile.

    Without a ``capacity`` memory is sized by the number of intersections, and a GPU is waited for to know it.
    """
    views, per_view, _ = records.shape
    n, where = views * per_view, records.device
    device = wp.device_from_torch(where)
    tiles_across, tiles_down = view.tiles
    count = views * tiles_across * tiles_down
    tiles = wp.vec2i(tiles_across, tiles_down)
    in_records = wp.from_torch(records.view(-1, 16), dtype=record16, return_ctype=True)

    # the radix sorts want room for twice what they sort
    depths = wp.from_torch(scratch("depth", 2 * n, torch.float32, where))
    ranked = scratch("ranked", 2 * n, torch.int32, where)
    order = wp.from_torch(ranked)
    areas = wp.from_torch(scratch("areas", 4 * n, torch.int32, where).view(n, 4), dtype=wp.vec4i)
    launch(kernels.find_tiles, n, [in_records, per_view, tiles, depths, order, areas], device, threads)
    wp.utils.radix_sort_pairs(depths, order, n)

    ends = torch.empty(n, dtype=torch.int32, device=where)
    in_ends = wp.from_torch(ends)
    launch(kernels.count_tiles, n, [areas, order, in_ends], device, threads)
    wp.utils.array_scan(in_ends, in_ends, inclusive=True)
    m = capacity if capacity is not None else int(ends[-1]) if n else 0

    keys = scratch("tile", 2 * m, torch.int32, where)
    if capacity is not None:
        keys.fill_(count)
    tile_keys = wp.from_torch(keys)
    isects = scratch("isect", 2 * m, torch.int32, where)
    sorted_isects = wp.from_torch(isects)
    gaussian_from_isect = torch.empty(m, dtype=torch.int32, device=where)
    outputs = [tile_keys, sorted_isects, wp.from_torch(gaussian_from_isect)]
    launch(kernels.emit, n, [areas, order, in_ends, tiles, *outputs], device, threads)
    wp.utils.radix_sort_pairs(tile_keys, sorted_isects, m, 0, count.bit_length())

    ranges = torch.zeros(count, 2, dtype=torch.int32, device=where)
    launch(kernels.find_ranges, m, [tile_keys, m, wp.from_torch(ranges, dtype=wp.vec2i)], device, threads)
    return Binned(ranked[:n].clone(), ends, gaussian_from_isect, isects[:m].clone(), ranges)
