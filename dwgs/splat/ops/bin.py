"""Records to tiles. Nothing here is differentiable; the adjoint of compositing reuses it."""

from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from dwgs.splat.kernels import bin_cpu, bin_cuda
from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.project import record16
from dwgs.splat.ops.scratch import scratch
from dwgs.splat.parallel import even, launch
from dwgs.splat.splats import View

_EMPTY_TILE = 8
"""Work of a tile without Gaussians, in intersections."""
_WORTH_A_THREAD = 8192
"""Gaussians that take longer to bin than to hand over."""


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

    def chunks(self, count: int) -> list[int]:
        """Bounds of ``count`` runs of tiles that hold about equal work."""
        return _chunks(self.ranges, count)

    def to_warp(self) -> Any:
        """The same arrays for the compositing kernels."""
        bins = Bins()
        bins.ranges = wp.from_torch(self.ranges, dtype=wp.vec2i)
        bins.isect_from_sorted = wp.from_torch(self.isect_from_sorted)
        bins.gaussian_from_isect = wp.from_torch(self.gaussian_from_isect)
        return bins


def bin(records: Tensor, view: View, capacity: int | None, threads: int) -> Binned:
    """Cut the records [V, N, 16] by tile, sort each tile by depth.

    Without a ``capacity`` a GPU is waited for, to know how many intersections there are; a CPU needs none.
    """
    return _WAYS[records.device.type](records, view, capacity, threads)


def _deal(records: Tensor, view: View, _capacity: int | None, threads: int) -> Binned:
    device, tiles, count = wp.get_device("cpu"), wp.vec2i(*view.tiles), len(records) * view.tiles[0] * view.tiles[1]
    n, per_view = records.shape[0] * records.shape[1], records.shape[1]
    runs = even(n, _WORTH_A_THREAD, threads)
    bounds = torch.tensor(runs, dtype=torch.int32)
    each = list(range(len(runs)))
    scene = [_records(records), wp.from_torch(bounds, return_ctype=True), per_view, tiles]

    ends = torch.empty(n, dtype=torch.int32)
    in_ends = wp.from_torch(ends)
    places = wp.from_torch(scratch("places", (len(runs) - 1) * count, torch.int32, records.device).view(-1, count))
    launch(bin_cpu.count, each, [*scene, in_ends, places], device, threads)
    wp.utils.array_scan(in_ends, in_ends, inclusive=True)
    ranges = torch.empty(count, 2, dtype=torch.int32)
    in_ranges = wp.from_torch(ranges, dtype=wp.vec2i)
    launch(bin_cpu.allot, [0, 1], [places, in_ranges], device, threads)

    m = int(ends[-1]) if n else 0
    depths, spare_depths = scratch("depths", 2 * m, torch.float32, records.device).view(2, m)
    isects, gaussian_from_isect = torch.empty(m, dtype=torch.int32), torch.empty(m, dtype=torch.int32)
    spare_isects = scratch("spare_isects", m, torch.int32, records.device)
    in_depths, in_isects = wp.from_torch(depths), wp.from_torch(isects)
    outputs = [places, in_depths, in_isects, wp.from_torch(gaussian_from_isect)]
    launch(bin_cpu.deal, each, [*scene, in_ends, *outputs], device, threads)
    spares = [wp.from_torch(spare_depths), wp.from_torch(spare_isects)]
    spans = _chunks(ranges, len(even(m, _WORTH_A_THREAD, threads)) - 1)
    launch(bin_cpu.sort, spans, [in_ranges, in_depths, in_isects, *spares], device, threads)
    return Binned(ends, gaussian_from_isect, isects, ranges)


def _sort(records: Tensor, view: View, capacity: int | None, _threads: int) -> Binned:
    where = records.device
    device, tiles, count = (
        wp.device_from_torch(where),
        wp.vec2i(*view.tiles),
        len(records) * view.tiles[0] * view.tiles[1],
    )
    n, per_view = records.shape[0] * records.shape[1], records.shape[1]
    in_records = _records(records)

    areas = wp.from_torch(scratch("areas", 4 * n, torch.int32, where).view(n, 4), dtype=wp.vec4i)
    ends = torch.empty(n, dtype=torch.int32, device=where)
    in_ends = wp.from_torch(ends)
    wp.launch(bin_cuda.count, n, [in_records, per_view, tiles, areas, in_ends], device=device)
    wp.utils.array_scan(in_ends, in_ends, inclusive=True)
    m = capacity if capacity is not None else int(ends[-1]) if n else 0

    # the radix sort wants room for twice what it sorts
    keys = scratch("keys", 2 * m, torch.int64, where)
    if capacity is not None:
        keys.fill_(count << bin_cuda.DEPTH_BITS)
    in_keys = wp.from_torch(keys)
    isects = scratch("isects", 2 * m, torch.int32, where)
    in_isects = wp.from_torch(isects)
    gaussian_from_isect = torch.empty(m, dtype=torch.int32, device=where)
    outputs = [in_keys, in_isects, wp.from_torch(gaussian_from_isect)]
    wp.launch(bin_cuda.emit, n, [in_records, areas, in_ends, tiles, *outputs], device=device)
    wp.utils.radix_sort_pairs(in_keys, in_isects, m, 0, bin_cuda.DEPTH_BITS + count.bit_length())

    ranges = torch.zeros(count, 2, dtype=torch.int32, device=where)
    wp.launch(bin_cuda.find_ranges, m, [in_keys, m, wp.from_torch(ranges, dtype=wp.vec2i)], device=device)
    return Binned(ends, gaussian_from_isect, isects[:m].clone(), ranges)


_WAYS = {"cpu": _deal, "cuda": _sort}


def _chunks(ranges: Tensor, count: int) -> list[int]:
    """Bounds of ``count`` runs of tiles that hold about equal work."""
    if count == 1:
        return [0, len(ranges)]
    work = (ranges[:, 1] - ranges[:, 0] + _EMPTY_TILE).cumsum(0)
    shares = torch.arange(1, count, device=work.device) * (int(work[-1]) / count)
    return [0, *torch.searchsorted(work, shares).tolist(), len(work)]


def _records(records: Tensor) -> Any:
    return wp.from_torch(records.view(-1, 16), dtype=record16, return_ctype=True)
