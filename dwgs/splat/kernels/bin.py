# type: ignore  (Warp's language, which is not Python's)
"""Which Gaussians touch which tile, nearest first.

An intersection is one Gaussian in one tile. Intersections are emitted in order of depth, so a stable sort
by tile alone leaves each tile sorted by depth; and those of one Gaussian lie side by side, which `gather`
lives on.
"""

import warp as wp

from dwgs.splat import constants
from dwgs.splat.kernels.project import record16

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
def find_tiles(
    first: int,
    records: wp.array(dtype=record16),
    per_view: int,
    tiles: wp.vec2i,
    # outputs
    depths: wp.array(dtype=float),
    order: wp.array(dtype=int),
    areas: wp.array(dtype=wp.vec4i),
):
    """Columns and rows of tiles each Gaussian touches, and its centre depth; what is not drawn goes last."""
    i = first + wp.tid()
    record = records[i]
    depth = float(wp.inf)
    area = wp.vec4i()
    if record[10] > 0.0:
        depth = record[9]
        across = tile_span(record[0], record[10], tiles[0])
        down = tile_span(record[1], record[11], tiles[1])
        above = i / per_view * tiles[1]  # images lie one under the other
        area = wp.vec4i(across[0], across[1], above + down[0], above + down[1])
    depths[i] = depth
    order[i] = i
    areas[i] = area


@wp.kernel
def count_tiles(
    first: int,
    areas: wp.array(dtype=wp.vec4i),
    gaussian_from_rank: wp.array(dtype=int),
    # outputs
    counts: wp.array(dtype=int),
):
    """Number of tiles each Gaussian touches, by rank in depth."""
    rank = first + wp.tid()
    area = areas[gaussian_from_rank[rank]]
    counts[rank] = (area[1] - area[0]) * (area[3] - area[2])


@wp.kernel
def emit(
    first: int,
    areas: wp.array(dtype=wp.vec4i),
    gaussian_from_rank: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    tiles: wp.vec2i,
    # outputs
    keys: wp.array(dtype=int),
    values: wp.array(dtype=int),
    gaussian_from_isect: wp.array(dtype=int),
):
    """Write the intersections of each Gaussian: tile, own index, Gaussian; those for which there is room."""
    rank = first + wp.tid()
    gaussian = gaussian_from_rank[rank]
    area = areas[gaussian]
    isect = ends[rank] - (area[1] - area[0]) * (area[3] - area[2])
    for row in range(area[2], area[3]):
        for column in range(area[0], area[1]):
            if isect < gaussian_from_isect.shape[0]:
                keys[isect] = row * tiles[0] + column
                values[isect] = isect
                gaussian_from_isect[isect] = gaussian
            isect += 1


@wp.kernel
def find_ranges(first: int, tile_from_sorted: wp.array(dtype=int), count: int, ranges: wp.array(dtype=wp.vec2i)):
    """First and one past the last sorted intersection of each tile; ``ranges`` starts as zeros.

    Room that was left over bears the number after the last tile.
    """
    k = first + wp.tid()
    tile = tile_from_sorted[k]
    if tile < ranges.shape[0]:
        if k == 0 or tile_from_sorted[wp.max(k - 1, 0)] != tile:
            ranges[tile][0] = k
        if k == count - 1 or tile_from_sorted[wp.min(k + 1, count - 1)] != tile:
            ranges[tile][1] = k + 1
