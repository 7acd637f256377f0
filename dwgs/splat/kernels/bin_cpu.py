# type: ignore  (Warp's language, which is not Python's)
"""Binning on a CPU: deal the intersections out to their tiles, then sort each tile by itself.

Gaussians are cut into a few runs. Every run knows from the counts of those before it where in
each tile its own intersections begin, so that runs write at the same time what one alone would have written.
"""

import warp as wp

from dwgs.splat.kernels.bins import TOUCHED
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

_EACH = f"""
    {TOUCHED}
    int* const place = places.data + run * (long long)places.shape[1];
    const int begin = run * run_size, end = begin + run_size < ends.shape[0] ? begin + run_size : ends.shape[0];
    auto each = [&](const wp::vec4i& area, auto visit) -> void {{  // tile, one loop: less to guess than two
        const int across = area[1] - area[0], size = across * (area[3] - area[2]);
        int tile = area[2] * tiles[0] + area[0];
        for (int k = 0, column = 1; k < size; ++k, ++column) {{
            visit(tile);
            const bool is_last = column == across;
            tile += is_last ? tiles[0] - across + 1 : 1;
            column = is_last ? 0 : column;
        }}
    }};
"""
_COUNT = f"""
{_EACH}
    for (int tile = 0; tile < places.shape[1]; ++tile) place[tile] = 0;
    for (int i = begin; i < end; ++i) {{
        const wp::vec4i area = touched(i);
        ends.data[i] = (area[1] - area[0]) * (area[3] - area[2]);
        each(area, [&](int tile) {{ ++place[tile]; }});
    }}
"""
_DEAL = f"""
{_EACH}
    int isect = begin ? ends.data[begin - 1] : 0;
    for (int i = begin; i < end; ++i) {{
        const float depth = ((const float*)&records.data[i])[9];
        each(touched(i), [&](int tile) {{
            const int to = place[tile]++;
            depths.data[to] = depth;
            isects.data[to] = isect;
            gaussian_from_isect.data[isect++] = i;
        }});
    }}
"""


@wp.func_native(_COUNT)
def count_run(
    run: int,
    run_size: int,
    records: wp.array(dtype=record16),
    per_view: int,
    tiles: wp.vec2i,
    ends: wp.array(dtype=int),
    places: wp.array2d(dtype=int),
):
    """How many tiles each Gaussian of a run touches (in ``ends``), and how many of the run touch each tile."""


@wp.func_native(_DEAL)
def deal_run(
    run: int,
    run_size: int,
    records: wp.array(dtype=record16),
    per_view: int,
    tiles: wp.vec2i,
    ends: wp.array(dtype=int),
    places: wp.array2d(dtype=int),
    depths: wp.array(dtype=float),
    isects: wp.array(dtype=int),
    gaussian_from_isect: wp.array(dtype=int),
):
    """Put the intersections of a run where its tiles want them: depth and number."""


@wp.func_native("""
    int total = 0;
    for (int i = 0; i < ends.shape[0]; ++i) ends.data[i] = total += ends.data[i];
    const int runs = places.shape[0], tiles = places.shape[1];
    for (int tile = 0, place = 0; tile < tiles; ++tile) {
        ranges.data[tile][0] = place;
        for (int run = 0; run < runs; ++run) {
            int& own = places.data[run * (long long)tiles + tile];
            const int size = own;
            own = place;
            place += size;
        }
        ranges.data[tile][1] = place;
    }
    return total;
""")
def allot(ends: wp.array(dtype=int), places: wp.array2d(dtype=int), ranges: wp.array(dtype=wp.vec2i)) -> int:
    """From counts to places: where each Gaussian ends, where each run begins in each tile, and each tile.

    Returns the number of intersections.
    """


_SORT = """
    // Digit by digit from the last, stable: what is as deep stays in order. Depths are positive: their bits are in
    // the order of their values. A digit that all have in common needs no pass.
    const int begin = ranges.data[tile][0], count = ranges.data[tile][1] - begin;
    unsigned *keys = (unsigned*)depths.data + begin, *to_keys = (unsigned*)spare_depths.data + begin;
    int *values = isects.data + begin, *to_values = spare_isects.data + begin;
    if (count <= 24) {  // so few are quicker inserted
        for (int k = 1; k < count; ++k) {
            const unsigned key = keys[k];
            const int value = values[k];
            int hole = k;
            for (; hole > 0 && keys[hole - 1] > key; --hole)
                keys[hole] = keys[hole - 1], values[hole] = values[hole - 1];
            keys[hole] = key, values[hole] = value;
        }
        return;
    }
    int places[4][256] = {};
    for (int k = 0; k < count; ++k)
        for (int digit = 0; digit < 4; ++digit) ++places[digit][keys[k] >> 8 * digit & 255];
    for (int digit = 0; digit < 4; ++digit) {
        int* const place = places[digit];
        if (place[keys[0] >> 8 * digit & 255] == count) continue;
        for (int value = 0, next = 0; value < 256; ++value) {
            const int size = place[value];
            place[value] = next;
            next += size;
        }
        for (int k = 0; k < count; ++k) {
            const int to = place[keys[k] >> 8 * digit & 255]++;
            to_keys[to] = keys[k], to_values[to] = values[k];
        }
        unsigned* const k = keys; keys = to_keys; to_keys = k;
        int* const v = values; values = to_values; to_values = v;
    }
    if (values != isects.data + begin)
        for (int k = 0; k < count; ++k) isects.data[begin + k] = values[k];
"""


@wp.func_native(_SORT)
def sort_tile(
    tile: int,
    ranges: wp.array(dtype=wp.vec2i),
    depths: wp.array(dtype=float),
    isects: wp.array(dtype=int),
    spare_depths: wp.array(dtype=float),
    spare_isects: wp.array(dtype=int),
):
    """Order the intersections of a tile by depth; the spare arrays are as large."""
