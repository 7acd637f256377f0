# type: ignore  (Warp's language, which is not Python's)
"""Which Gaussians touch which tile, nearest first.

An intersection is one Gaussian in one tile. Intersections are emitted in order of depth, so a stable sort
by tile alone leaves each tile sorted by depth; and those of one Gaussian lie side by side, which `gather`
lives on.
"""

import warp as wp

from dwgs.splat import constants
from dwgs.splat.kernels.project import record12

wp.set_module_options({"enable_backward": False})

TILE = wp.constant(constants.TILE)


@wp.struct
class Bins:
    """What a tile has to draw: intersections ``ranges[tile]`` of the sorted order, nearest first."""

    ranges: wp.array(dtype=wp.vec2i)
    isect_from_sorted: wp.array(dtype=int)
    gaussian_from_isect: wp.array(dtype=int)


@wp.func
def tile_span(center: float, extent: float, tiles: int) -> wp.vec2i:
    """First tile and one past the last whose pixel centres the interval can reach along one axis."""
    size = float(TILE)
    low = wp.clamp(wp.floor((center - extent - 0.5) / size), 0.0, float(tiles))
    high = wp.clamp(wp.floor((center + extent - 0.5) / size) + 1.0, low, float(tiles))
    return wp.vec2i(int(low), int(high))


@wp.kernel
def depth_keys(
    first: int, records: wp.array(dtype=record12), keys: wp.array(dtype=float), values: wp.array(dtype=int)
):
    """Centre depth of each Gaussian; what is not drawn goes last."""
    i = first + wp.tid()
    record = records[i]
    key = float(wp.inf)
    if record[10] > 0.0:
        key = record[9]
    keys[i] = key
    values[i] = i


@wp.kernel
def count_tiles(
    first: int,
    records: wp.array(dtype=record12),
    gaussian_from_rank: wp.array(dtype=int),
    tiles: wp.vec2i,
    # outputs
    counts: wp.array(dtype=int),
):
    """Number of tiles each Gaussian touches, by rank in depth."""
    rank = first + wp.tid()
    record = records[gaussian_from_rank[rank]]
    count = int(0)  # noqa: RUF046, UP018  (a variable, not a constant)
    if record[10] > 0.0:
        across = tile_span(record[0], record[10], tiles[0])
        down = tile_span(record[1], record[11], tiles[1])
        count = (across[1] - across[0]) * (down[1] - down[0])
    counts[rank] = count


@wp.kernel
def emit(
    first: int,
    records: wp.array(dtype=record12),
    gaussian_from_rank: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    tiles: wp.vec2i,
    # outputs
    keys: wp.array(dtype=int),
    values: wp.array(dtype=int),
    gaussian_from_isect: wp.array(dtype=int),
):
    """Write the intersections of each Gaussian: tile, own index, Gaussian."""
    rank = first + wp.tid()
    isect = int(0)  # noqa: RUF046, UP018  (a variable, not a constant)
    if rank > 0:
        isect = ends[rank - 1]
    if isect < ends[rank]:
        gaussian = gaussian_from_rank[rank]
        record = records[gaussian]
        across = tile_span(record[0], record[10], tiles[0])
        down = tile_span(record[1], record[11], tiles[1])
        for row in range(down[0], down[1]):
            for column in range(across[0], across[1]):
                keys[isect] = row * tiles[0] + column
                values[isect] = isect
                gaussian_from_isect[isect] = gaussian
                isect += 1


@wp.kernel
def find_ranges(
    first: int, tile_from_sorted: wp.array(dtype=int), count: int, ranges: wp.array(dtype=wp.vec2i)
):
    """First and one past the last sorted intersection of each tile; ``ranges`` starts as zeros."""
    k = first + wp.tid()
    tile = tile_from_sorted[k]
    if k == 0 or tile_from_sorted[wp.max(k - 1, 0)] != tile:
        ranges[tile][0] = k
    if k == count - 1 or tile_from_sorted[wp.min(k + 1, count - 1)] != tile:
        ranges[tile][1] = k + 1
