# type: ignore  (Warp's language, which is not Python's)
"""Binning on a GPU: deal intersections to their tiles in any order, then sort each tile by itself.

What a tile is sorted by is unique, depth before number, so that the order it was dealt in leaves no trace. A block
sorts the intersections of one tile, in shared memory as far as there is room for them.
"""

import warp as wp

from dwgs.splat.kernels.bins import TOUCHED
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

SORTERS = 512
"""Threads that sort a tile."""
_ROOM = 4096
"""Keys in shared memory; of longer lists the long strides are taken through global memory."""


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
def tally(
    areas: wp.array(dtype=wp.vec4i),
    ends: wp.array(dtype=int),
    tiles: wp.vec2i,
    # outputs
    sizes: wp.array(dtype=int),
    places: wp.array(dtype=int),
):
    """How many intersections each tile has, of those for which there is room, and a place in it for each.

    ``sizes`` starts as zeros.
    """
    i = wp.tid()
    area = areas[i]
    isect = ends[i] - size_of(area)
    for row in range(area[2], area[3]):
        for column in range(area[0], area[1]):
            if isect < places.shape[0]:
                places[isect] = wp.atomic_add(sizes, row * tiles[0] + column, 1)
            isect += 1


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
):
    """Write the intersections of each Gaussian to their places.

    Depths are positive: their bits are in the order of their values.
    """
    i = wp.tid()
    area = areas[i]
    isect = ends[i] - size_of(area)
    depth = wp.uint64(wp.cast(records[i][9], wp.uint32)) << wp.uint64(32)
    for row in range(area[2], area[3]):
        for column in range(area[0], area[1]):
            if isect < places.shape[0]:
                tile = row * tiles[0] + column
                keys[tile_ends[tile] - sizes[tile] + places[isect]] = depth | wp.uint64(isect)
                gaussian_from_isect[isect] = i
            isect += 1


@wp.func_native(f"""
    const int end = tile_ends.data[tile], begin = tile ? tile_ends.data[tile - 1] : 0, count = end - begin;
    unsigned long long* const own = (unsigned long long*)keys.data + begin;
    if (thread == 0) ranges.data[tile] = wp::vec_t<2, int>(begin, end);
    #if defined(__CUDA_ARCH__)
    // a bitonic network of the next power of two; what is past the end counts as the largest and never moves
    __shared__ unsigned long long shared[{_ROOM}];
    int size = 2;
    while (size < count) size *= 2;
    auto exchange = [&](unsigned long long* at, int i, int j) {{
        if (at[i] > at[j]) {{ const unsigned long long other = at[i]; at[i] = at[j]; at[j] = other; }}
    }};
    // all pairs of one stride in at[0, span); at the first of a run its halves meet from both ends
    auto pass = [&](unsigned long long* at, int span, int known, int stride, bool is_first, int next_stride) {{
        for (int k = threadIdx.x; k < span / 2; k += {SORTERS}) {{
            const int inside = k & (stride - 1), run = (k - inside) * 2, i = run + inside;
            const int j = is_first ? run + 2 * stride - 1 - inside : i + stride;
            if (j < known) exchange(at, i, j);
        }}
        // the 64 keys of a warp are its own as long as strides are short
        if (stride > 32 || next_stride > 32) __syncthreads(); else __syncwarp();
    }};
    auto merge = [&](unsigned long long* at, int span, int known, int run) {{  // sorted halves of runs
        for (int stride = run / 2; stride > 0; stride /= 2)
            pass(at, span, known, stride, 2 * stride == run, stride > 1 ? stride / 2 : run);
    }};
    for (int chunk = 0; chunk < count; chunk += {_ROOM}) {{
        const int known = count - chunk < {_ROOM} ? count - chunk : {_ROOM}, span = size < {_ROOM} ? size : {_ROOM};
        for (int k = threadIdx.x; k < known; k += {SORTERS}) shared[k] = own[chunk + k];
        __syncthreads();
        for (int run = 2; run <= span; run *= 2) merge(shared, span, known, run);
        __syncthreads();
        for (int k = threadIdx.x; k < known; k += {SORTERS}) own[chunk + k] = shared[k];
        __syncthreads();
    }}
    for (int run = 2 * {_ROOM}; run <= size; run *= 2) merge(own, size, count, run);
    __syncthreads();
    for (int k = threadIdx.x; k < count; k += {SORTERS}) isects.data[begin + k] = (int)(own[k] & 0xffffffffull);
    #else
    for (int k = 1; k < count; ++k) {{
        const unsigned long long key = own[k];
        int place = k;
        for (; place > 0 && own[place - 1] > key; --place) own[place] = own[place - 1];
        own[place] = key;
    }}
    for (int k = 0; k < count; ++k) isects.data[begin + k] = (int)(own[k] & 0xffffffffull);
    #endif
""")
def sort_tile(
    tile: int,
    thread: int,
    tile_ends: wp.array(dtype=int),
    keys: wp.array(dtype=wp.uint64),
    isects: wp.array(dtype=int),
    ranges: wp.array(dtype=wp.vec2i),
):
    """Sort the keys of a tile by all threads of a block, or by one thread on a CPU."""


@wp.kernel
def sort(
    tile_ends: wp.array(dtype=int),
    keys: wp.array(dtype=wp.uint64),
    sorters: int,
    # outputs
    isect_from_sorted: wp.array(dtype=int),
    ranges: wp.array(dtype=wp.vec2i),
):
    """Put every tile in order, by so many ``sorters`` each, and say where it lies."""
    sort_tile(wp.tid() / sorters, wp.tid() % sorters, tile_ends, keys, isect_from_sorted, ranges)
