"""Projecting, binning and compositing on a GPU."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
import warp as wp
from torch import Tensor

from dwgs.splat.kernels import bin_cuda, composite_cuda
from dwgs.splat.kernels.gather import GATHERERS, gather, slot10
from dwgs.splat.ops.binned import Binned
from dwgs.splat.ops.project import Subject, SubjectGradient, as_records, project_adjoint, project_into
from dwgs.splat.parallel import BLOCK


@dataclass(frozen=True)
class BinnedOnCuda(Binned):
    """What blocks need besides."""

    reached_from_isect: Tensor
    """[M] which warps of the tile draw it, a bit for each."""
    tile_from_block: Tensor
    """[tiles] those that have something first."""


@dataclass(frozen=True)
class Drawn(BinnedOnCuda):
    """And what the first pass keeps for the adjoint, see `kernels.composite_cuda`."""

    states: Tensor
    """[segments * (5 + F) * 256] of the pixels."""
    tile_from_segment: Tensor
    """[segments] -1: never reached."""


def draw(
    canvas: Any,
    subject: Subject,
    records: Tensor,
    image: Tensor,
    capacity: int | None,
    threads: int,
    trains: bool = False,
) -> BinnedOnCuda:
    """Project a subject to the first of the records [V, N, 16], bin all and fill the ``image``, which may be empty.

    With what it keeps where it ``trains``, the adjoint can follow.
    """
    if sum(subject.objects.counts):
        project_into(records, subject, threads)
    binned = _bin(canvas, records, capacity)
    if not image.numel():
        return binned
    segments = len(binned.gaussian_from_isect) // composite_cuda.SEGMENT + len(binned.ranges) if trains else 0
    states = records.new_empty(segments * image.shape[1] * composite_cuda.BLOCK)
    tile_from_segment = torch.full((segments,), -1, dtype=torch.int32, device=records.device)
    outputs = [wp.from_torch(tensor) for tensor in (image.view(-1), states, tile_from_segment)]
    order = [wp.from_torch(tensor) for tensor in (binned.reached_from_isect, binned.tile_from_block)]
    inputs = [canvas, binned.to_warp(), *order, as_records(records), *outputs]
    _launch(composite_cuda.composite, len(binned.ranges) * composite_cuda.BLOCK, inputs, records, composite_cuda.BLOCK)
    return Drawn(**vars(binned), states=states, tile_from_segment=tile_from_segment)


def draw_adjoint(
    canvas: Any,
    subject: Subject,
    drawn: Drawn,
    records: Tensor,
    image: Tensor,
    v_image: Any,
    v_records: Tensor,
    v_features: Tensor,
    v_subject: SubjectGradient | None,
    threads: int,
) -> None:
    """Fill the gradients [V, T, 16] and [V, T, F] of the first T Gaussians of each view, and that of the subject."""
    trainable, features = v_features.shape[1:]
    count, parts = len(drawn.gaussian_from_isect), (composite_cuda.PARTS, composite_cuda.FEATURE_PARTS)
    slots = wp.from_torch(records.new_zeros(count * parts[0], 10), dtype=slot10)
    feature_slots = wp.from_torch(records.new_zeros(count * parts[1] * features))
    kept = [wp.from_torch(tensor) for tensor in (image.view(-1), drawn.states, drawn.tile_from_segment)]
    inputs = [canvas, drawn.to_warp(), wp.from_torch(drawn.reached_from_isect), as_records(records), *kept]
    inputs += [v_image, trainable, slots, feature_slots]
    items = len(drawn.tile_from_segment) * composite_cuda.BLOCK
    _launch(composite_cuda.composite_adjoint, items, inputs, records, composite_cuda.BLOCK)
    numbers = [*parts, records.shape[1], trainable, features]
    outputs = [as_records(v_records), wp.from_torch(v_features.flatten(0, 1))]
    inputs = [slots, feature_slots, wp.from_torch(drawn.ends), *numbers, as_records(records), *outputs]
    _launch(gather, len(drawn.ends) * GATHERERS, inputs, records)
    if v_subject is not None:
        project_adjoint(v_subject, subject, records, v_records, threads)


def _bin(canvas: Any, records: Tensor, capacity: int | None) -> BinnedOnCuda:
    where, tiles = records.device, wp.vec2i(canvas.tiles_across, canvas.tiles_down)
    count = len(records) * canvas.tiles_across * canvas.tiles_down
    n, per_view = records.shape[0] * records.shape[1], records.shape[1]
    in_records = as_records(records)

    empty = partial(torch.empty, dtype=torch.int32, device=where)
    areas, counts = empty(n, 4), empty(n)
    in_areas = wp.from_torch(areas, dtype=wp.vec4i)
    _launch(bin_cuda.count, n, [in_records, per_view, tiles, in_areas, wp.from_torch(counts)], records)
    ends = counts.cumsum(0, dtype=torch.int32)  # Warp's scan frees memory, which no graph allows
    in_ends = wp.from_torch(ends)
    m = capacity if capacity is not None else int(ends[-1]) if n else 0

    zeros, keys = torch.zeros(count + 2, dtype=torch.int32, device=where), empty(2, m, dtype=torch.int64)
    sizes, listed = zeros.split([count, 2])
    gaussian_from_isect, isect_from_sorted, reached, ranges = empty(m), empty(m), empty(m), empty(count, 2)
    tile_from_block = empty(count)
    order = [wp.from_torch(listed), wp.from_torch(tile_from_block)]
    in_sizes, in_places = wp.from_torch(sizes), wp.from_torch(isect_from_sorted)  # whose room is free as yet
    dealers = n * bin_cuda.DEALERS
    _launch(bin_cuda.tally, dealers, [in_areas, in_ends, tiles, in_sizes, in_places, *order], records)
    in_tile_ends = wp.from_torch(sizes.cumsum(0, dtype=torch.int32))
    in_keys, in_spare_keys = (wp.from_torch(row, dtype=wp.uint64) for row in keys)
    places = [in_places, in_sizes, in_tile_ends]
    outputs = [in_keys, wp.from_torch(gaussian_from_isect), wp.from_torch(reached)]
    _launch(bin_cuda.deal, dealers, [in_records, in_areas, in_ends, tiles, *places, *outputs], records)
    sorters = bin_cuda.SORTERS if records.is_cuda else 1
    outputs = [wp.from_torch(isect_from_sorted), wp.from_torch(ranges, dtype=wp.vec2i), *order]
    inputs = [in_tile_ends, in_keys, in_spare_keys, sorters, *outputs]
    _launch(bin_cuda.sort, count * sorters, inputs, records, bin_cuda.SORTERS)
    return BinnedOnCuda(ends, gaussian_from_isect, isect_from_sorted, ranges, reached, tile_from_block)


def _launch(kernel: Any, items: int, inputs: list[Any], records: Tensor, block: int = BLOCK) -> None:
    device = wp.device_from_torch(records.device)
    wp.launch(kernel, items, inputs, device=device, block_dim=block, record_tape=False)
