# type: ignore  (Warp's language, which is not Python's)
"""Binning on a GPU: deal intersections to their tiles in any order, then sort each tile by itself.

What a tile is sorted by is unique, depth before number, so that the order it was dealt in leaves no trace. A block
sorts one tile: its warps sort runs, which it merges, every key finding its place in the run beside its own.

Blocks take the tiles that have something first: a GPU gives its multiprocessors one block each before it gives any of
them a second, so that work which lies close together in the image does not lie on a few of them.
"""

from math import log

import warp as wp

from dwgs.splat import constants
from dwgs.splat.kernels.bins import TOUCHED
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

DEALERS = 4
"""Threads that deal one Gaussian: to wait for a tile's counter takes long, and a Gaussian can have many tiles."""
SORTERS = 256
"""Threads that sort a tile."""
_ROOM = 2816
"""Keys of a tile that have room, twice, in shared memory; longer lists are sorted outside it."""
_AT_ONCE = 4
"""Keys a thread finds places for at once: their searches need not wait for each other."""
TILE = wp.constant(constants.TILE)
SLACK = 0.01
"""On the logarithm of alpha: no rounding hides a Gaussian from the pixels it reaches."""


@wp.func_native(f"{TOUCHED} return touched(i);")
def tiles_touched(records: wp.array(dtype=record16), i: int, per_view: int, tiles: wp.vec2i) -> wp.vec4i:
    """Columns and rows of tiles that a Gaussian reaches: first, one past the last; none if it is not drawn."""


@wp.func
def size_of(area: wp.vec4i) -> int:
    """Number of tiles."""
    return (area[1] - area[0]) * (area[3] - area[2])


@wp.func
def tile_of(area: wp.vec4i, k: int) -> wp.vec2i:
    """Column and row of one of so many."""
    width = area[1] - area[0]
    return wp.vec2i(area[0] + k % width, area[2] + k / width)


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
def tally(
    areas: wp.array(dtype=wp.vec4i),
    ends: wp.array(dtype=int),
    tiles: wp.vec2i,
    # outputs
    sizes: wp.array(dtype=int),
    places: wp.array(dtype=int),
    listed: wp.array(dtype=int),
    tile_from_block: wp.array(dtype=int),
):
    """How many intersections each tile has, of those for which there is room, and a place in it for each.

    Tiles that have any are listed, and their number is; it and ``sizes`` start as zeros.
    """
    i = wp.tid() / wp.static(DEALERS)
    area = areas[i]
    first = ends[i] - size_of(area)
    for k in range(wp.tid() % wp.static(DEALERS), wp.min(size_of(area), places.shape[0] - first), wp.static(DEALERS)):
        at = tile_of(area, k)
        tile = at[1] * tiles[0] + at[0]
        place = wp.atomic_add(sizes, tile, 1)
        places[first + k] = place
        if place == 0:
            tile_from_block[wp.atomic_add(listed, 0, 1)] = tile


@wp.func_native(f"""
    const float x = record[0], y = record[1], xx = record[2], xy = record[3], yy = record[4], log_opacity = record[12];
    const float slope_x = -xy / xx, slope_y = -xy / yy;
    auto clamp = [](float t, float low, float high) -> float {{ return t < low ? low : t > high ? high : t; }};
    auto power = [&](float dx, float dy) -> float {{ return -0.5f * (xx * dx * dx + yy * dy * dy) - xy * dx * dy; }};
    int reached = 0;
    #pragma unroll
    for (int warp = 0; warp < 8; ++warp) {{
        // off the mean, the outermost pixel centres; strongest, it is on one of the two edges nearest to it
        const float left = tile_x + warp % 2 * 8 + 0.5f - x, right = left + 7.0f;
        const float top = tile_y + warp / 2 * 4 + 0.5f - y, bottom = top + 3.0f;
        const float near_x = clamp(0.0f, left, right), near_y = clamp(0.0f, top, bottom);
        const float by_x = power(near_x, clamp(slope_y * near_x, top, bottom));
        const float by_y = power(clamp(slope_x * near_y, left, right), near_y);
        reached |= ((by_x > by_y ? by_x : by_y) + log_opacity > {log(constants.MIN_ALPHA) - SLACK}f) << warp;
    }}
    return reached;
""")
def warps_reached(record: record16, tile_x: int, tile_y: int) -> int:
    """Which blocks of 8x4 pixels of a tile a Gaussian reaches, a bit for each."""


@wp.kernel
def deal(
    records: wp.array(dtype=record16),
    areas: wp.array(dtype=wp.vec4i),
    ends: wp.array(dtype=int),
    tiles: wp.vec2i,
    places: wp.array(dtype=int),
    sizes: wp.array(dtype=int),
    tile_ends: wp.array(dtype=int),
    # outputs
    keys: wp.array(dtype=wp.uint64),
    gaussian_from_isect: wp.array(dtype=int),
    reached_from_isect: wp.array(dtype=int),
):
    """Write the intersections of each Gaussian to their places, and which warps of their tiles it reaches.

    Depths are positive: their bits are in the order of their values.
    """
    i = wp.tid() / wp.static(DEALERS)
    area = areas[i]
    first = ends[i] - size_of(area)
    depth = wp.uint64(wp.cast(records[i][9], wp.uint32)) << wp.uint64(32)
    for k in range(wp.tid() % wp.static(DEALERS), wp.min(size_of(area), places.shape[0] - first), wp.static(DEALERS)):
        isect = first + k
        at = tile_of(area, k)
        tile = at[1] * tiles[0] + at[0]
        keys[tile_ends[tile] - sizes[tile] + places[isect]] = depth | wp.uint64(isect)
        gaussian_from_isect[isect] = i
        reached_from_isect[isect] = warps_reached(records[i], at[0] * TILE, at[1] % tiles[1] * TILE)


SORT = f"""
    const int end = tile_ends.data[tile], begin = tile ? tile_ends.data[tile - 1] : 0, count = end - begin;
    unsigned long long* const own = (unsigned long long*)keys.data + begin;
    #if defined(__CUDA_ARCH__)
    __shared__ unsigned long long shared[2][{_ROOM}];
    const int lane = thread % 32;
    auto arrange = [&](auto key_of) -> void {{  // by two sides of memory
        for (int chunk = thread - lane; chunk < count; chunk += {SORTERS}) {{  // runs of 32: a bitonic network
            unsigned long long key = chunk + lane < count ? own[chunk + lane] : ~0ull;
            for (int run = 2; run <= 32; run *= 2)
                for (int stride = run / 2; stride > 0; stride /= 2) {{
                    const unsigned long long other = __shfl_xor_sync(~0u, key, stride);
                    if ((other < key) == (!(lane & run) == !(lane & stride))) key = other;
                }}
            if (chunk + lane < count) key_of(0, chunk + lane) = key;
        }}
        __syncthreads();
        int side = 0;
        for (int run = 32; run < count; run *= 2, side = 1 - side) {{
            for (int some = thread; some < count; some += {_AT_ONCE * SORTERS}) {{
                unsigned long long key[{_AT_ONCE}];
                int start[{_AT_ONCE}], end[{_AT_ONCE}], place[{_AT_ONCE}];
                #pragma unroll
                for (int i = 0; i < {_AT_ONCE}; ++i) {{
                    const int k = some + i * {SORTERS} < count ? some + i * {SORTERS} : some;
                    const int first = k & -2 * run, middle = first + run < count ? first + run : count;
                    const int last = middle + run < count ? middle + run : count;
                    key[i] = key_of(side, k);
                    start[i] = k < middle ? middle : first;  // of the run it is merged with
                    end[i] = k < middle ? last : middle;
                    place[i] = (k < middle ? k : k - run) - start[i];
                }}
                for (int step = run; step > 0; step /= 2)
                    #pragma unroll
                    for (int i = 0; i < {_AT_ONCE}; ++i) {{  // how many keys of that run are smaller
                        const int next = start[i] + step, at = next <= end[i] ? next - 1 : 0;
                        start[i] += (next <= end[i]) & (key_of(side, at) < key[i]) ? step : 0;
                    }}
                #pragma unroll
                for (int i = 0; i < {_AT_ONCE}; ++i)
                    if (some + i * {SORTERS} < count) key_of(1 - side, start[i] + place[i]) = key[i];
            }}
            __syncthreads();
        }}
        for (int k = thread; k < count; k += {SORTERS}) isects.data[begin + k] = (int)(key_of(side, k) & 0xffffffffull);
    }};
    if (count <= {_ROOM})
        arrange([&](int side, int k) -> unsigned long long& {{ return shared[side][k]; }});
    else
        arrange([&](int side, int k) -> unsigned long long& {{
            return side ? own[k] : ((unsigned long long*)spare_keys.data)[begin + k];
        }});
    #else
    for (int k = 1; k < count; ++k) {{
        const unsigned long long key = own[k];
        int place = k;
        for (; place > 0 && own[place - 1] > key; --place) own[place] = own[place - 1];
        own[place] = key;
    }}
    for (int k = 0; k < count; ++k) isects.data[begin + k] = (int)(own[k] & 0xffffffffull);
    #endif
"""
"""Of one tile; `tests/splat/test_sort_of_a_tile.py` runs it on threads that play a block."""


@wp.func_native(SORT)
def sort_tile(
    tile: int,
    thread: int,
    tile_ends: wp.array(dtype=int),
    keys: wp.array(dtype=wp.uint64),
    spare_keys: wp.array(dtype=wp.uint64),
    isects: wp.array(dtype=int),
):
    """Sort the keys of a tile by all threads of a block, or by one thread on a CPU."""


@wp.kernel
def sort(
    tile_ends: wp.array(dtype=int),
    keys: wp.array(dtype=wp.uint64),
    spare_keys: wp.array(dtype=wp.uint64),
    sorters: int,
    # outputs
    isect_from_sorted: wp.array(dtype=int),
    ranges: wp.array(dtype=wp.vec2i),
    listed: wp.array(dtype=int),
    tile_from_block: wp.array(dtype=int),
):
    """Put every tile in order, by so many ``sorters`` each, and say where it lies; list those without anything, too.

    From the end: of them ``listed`` has the number after that of the others.
    """
    block = wp.tid() / sorters
    thread = wp.tid() % sorters
    if thread == 0:
        begin = int(0)  # noqa: RUF046, UP018  (a variable, not a constant)
        if block > 0:
            begin = tile_ends[block - 1]
        ranges[block] = wp.vec2i(begin, tile_ends[block])
        if begin == tile_ends[block]:
            tile_from_block[tile_ends.shape[0] - 1 - wp.atomic_add(listed, 1, 1)] = block
    if block < listed[0]:
        sort_tile(tile_from_block[block], thread, tile_ends, keys, spare_keys, isect_from_sorted)
