# type: ignore  (Warp's language, which is not Python's)
"""Binning on a GPU: write a key for every intersection, tile before depth, and let a radix sort do the rest."""

import warp as wp

from dwgs.splat.kernels.bins import TOUCHED
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

DEPTH_BITS = 32


@wp.func_native(f"{TOUCHED} return touched(i);")
def tiles_touched(records: wp.array(dtype=record16), i: int, per_view: int, tiles: wp.vec2i) -> wp.vec4i:
    """Columns and rows of tiles that a Gaussian reaches: first, one past the last; none if it is not drawn."""


@wp.func
def size_of(area: wp.vec4i) -> int:
    """Number of tiles."""
    return (area[1] - area[0]) * (area[3] - area[2])


@wp.kernel
def count(
    records: wp.array(dtype=record16),
    per_view: int,
    tiles: wp.vec2i,
    # outputs
    areas: wp.array(dtype=wp.vec4i),
    counts: wp.array(dtype=int),
):
    """Which and how many tiles each Gaussian touches."""
    i = wp.tid()
    area = tiles_touched(records, i, per_view, tiles)
    areas[i] = area
    counts[i] = size_of(area)


@wp.kernel
def emit(
    records: wp.array(dtype=record16),
    areas: wp.array(dtype=wp.vec4i),
    ends: wp.array(dtype=int),
    tiles: wp.vec2i,
    # outputs
    keys: wp.array(dtype=wp.int64),
    values: wp.array(dtype=int),
    gaussian_from_isect: wp.array(dtype=int),
):
    """Write the intersections of each Gaussian: tile and depth, own number, Gaussian; those for which there is room.

    Depths are positive: their bits are in the order of their values.
    """
    i = wp.tid()
    area = areas[i]
    isect = ends[i] - size_of(area)
    depth = wp.int64(wp.cast(records[i][9], wp.uint32))
    for row in range(area[2], area[3]):
        for column in range(area[0], area[1]):
            if isect < gaussian_from_isect.shape[0]:
                keys[isect] = (wp.int64(row * tiles[0] + column) << wp.int64(DEPTH_BITS)) | depth
                values[isect] = isect
                gaussian_from_isect[isect] = i
            isect += 1


@wp.kernel
def find_ranges(keys: wp.array(dtype=wp.int64), count: int, ranges: wp.array(dtype=wp.vec2i)):
    """First and one past the last sorted intersection of each tile; ``ranges`` starts as zeros.

    Room that was left over bears the number after the last tile.
    """
    k = wp.tid()
    tile = int(keys[k] >> wp.int64(DEPTH_BITS))
    if tile < ranges.shape[0]:
        if k == 0 or int(keys[wp.max(k - 1, 0)] >> wp.int64(DEPTH_BITS)) != tile:
            ranges[tile][0] = k
        if k == count - 1 or int(keys[wp.min(k + 1, count - 1)] >> wp.int64(DEPTH_BITS)) != tile:
            ranges[tile][1] = k + 1
