"""Binning and compositing on a GPU."""

from functools import partial
from typing import Any

import torch
import warp as wp
from torch import Tensor

from dwgs.splat.kernels import bin_cuda, composite_cuda
from dwgs.splat.kernels.gather import gather, slot10
from dwgs.splat.kernels.project import record16
from dwgs.splat.ops.binned import Binned


def draw(canvas: Any, records: Tensor, image: Tensor, capacity: int | None, _threads: int) -> Binned:
    """Bin records [V, N, 16] and fill the ``image``, which may be empty: then nothing is drawn."""
    binned = _bin(canvas, records, capacity)
    if image.numel():
        inputs = [canvas, binned.to_warp(), _records(records), wp.from_torch(image.view(-1))]
        _launch(composite_cuda.composite, len(binned.ranges) * composite_cuda.BLOCK, inputs, records)
    return binned


def draw_adjoint(
    canvas: Any,
    binned: Binned,
    records: Tensor,
    image: Tensor,
    v_image: Any,
    v_records: Tensor,
    v_features: Tensor,
    _threads: int,
) -> None:
    """Fill the gradients [V, T, 16] and [V, T, F] of the first T Gaussians of each view."""
    trainable, features = v_features.shape[1:]
    count, parts = len(binned.gaussian_from_isect), (composite_cuda.PARTS, composite_cuda.FEATURE_PARTS)
    slots = wp.from_torch(records.new_zeros(count * parts[0], 10), dtype=slot10)
    feature_slots = wp.from_torch(records.new_zeros(count * parts[1] * features))
    flat = wp.from_torch(image.view(-1))
    inputs = [canvas, binned.to_warp(), _records(records), flat, v_image, trainable, slots, feature_slots]
    _launch(composite_cuda.composite_adjoint, len(binned.ranges) * composite_cuda.BLOCK, inputs, records)
    numbers = [*parts, records.shape[1], trainable, features]
    outputs = [_records(v_records), wp.from_torch(v_features.flatten(0, 1))]
    inputs = [slots, feature_slots, wp.from_torch(binned.ends), *numbers, _records(records), *outputs]
    _launch(gather, len(binned.ends), inputs, records)


def _bin(canvas: Any, records: Tensor, capacity: int | None) -> Binned:
    where, tiles = records.device, wp.vec2i(canvas.tiles_across, canvas.tiles_down)
    count = len(records) * canvas.tiles_across * canvas.tiles_down
    n, per_view = records.shape[0] * records.shape[1], records.shape[1]
    in_records = _records(records)

    empty = partial(torch.empty, dtype=torch.int32, device=where)
    areas, counts = wp.from_torch(empty(n, 4), dtype=wp.vec4i), empty(n)
    _launch(bin_cuda.count, n, [in_records, per_view, tiles, areas, wp.from_torch(counts)], records)
    ends = counts.cumsum(0, dtype=torch.int32)  # Warp's scan frees memory, which no graph allows
    in_ends = wp.from_torch(ends)
    m = capacity if capacity is not None else int(ends[-1]) if n else 0

    # the radix sort wants room for twice what it sorts
    keys = empty(2 * m, dtype=torch.int64)
    if capacity is not None:
        keys.fill_(count << bin_cuda.DEPTH_BITS)
    isects, gaussian_from_isect = empty(2 * m), empty(m)
    in_keys, in_isects = wp.from_torch(keys), wp.from_torch(isects)
    outputs = [in_keys, in_isects, wp.from_torch(gaussian_from_isect)]
    _launch(bin_cuda.emit, n, [in_records, areas, in_ends, tiles, *outputs], records)
    wp.utils.radix_sort_pairs(in_keys, in_isects, m, 0, bin_cuda.DEPTH_BITS + count.bit_length())

    ranges = torch.zeros(count, 2, dtype=torch.int32, device=where)
    _launch(bin_cuda.find_ranges, m, [in_keys, m, wp.from_torch(ranges, dtype=wp.vec2i)], records)
    return Binned(ends, gaussian_from_isect, isects[:m], ranges)


def _launch(kernel: Any, items: int, inputs: list[Any], records: Tensor) -> None:
    device = wp.device_from_torch(records.device)
    wp.launch(kernel, items, inputs, device=device, block_dim=composite_cuda.BLOCK, record_tape=False)


def _records(records: Tensor) -> Any:
    return wp.from_torch(records.view(-1, 16), dtype=record16)
