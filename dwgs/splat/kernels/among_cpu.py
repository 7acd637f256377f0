# type: ignore  (Warp's language, which is not Python's)
"""Frozen Gaussians among those that are learnt, on a CPU: dealt once, drawn again and again.

They are dealt to the blocks of 4x4 pixels that they touch, nearest first, without those that no light reaches even
where nothing else stands. Light meets them on its way between two splats of its block, so that a step neither projects
nor sorts them, nor asks which blocks they touch. What lies behind the last splat of a block stays as it is from step to
step, and is kept as an image.
"""

import warp as wp

from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.blocks import BATCH, GIVING, MEETING, PRELUDE
from dwgs.splat.kernels.canvas import Canvas
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

_KEPT = 8
"""Behind its last splat a block meets frozen Gaussians one by one up to the next multiple of this: the more, the longer
that takes, and the more rarely the rest is drawn anew. 8 and 32 take the same time."""
_AHEAD = 8
"""So many are fetched from memory ahead: they lie anywhere."""


@wp.struct
class Among:
    """Frozen Gaussians of one view, by the blocks that they touch, sixteen of each tile.

    Those of a block are ``members`` up to its ``ends``, nearest first. ``back`` [5, H', W'] is what lies behind the
    canvas with the members from ``begins`` on drawn over it, by block; -1: nobody asked yet.
    """

    records: wp.array(dtype=record16)
    ends: wp.array(dtype=int)
    members: wp.array(dtype=int)
    begins: wp.array(dtype=int)
    back: wp.array(dtype=float)


_MEMBER = """
    const float* const record = member(at);
    auto number = [&](int place, int) -> float {
        const float value = record[place];
        if (place < 2) return value - (place ? tile_y + 0.5f : tile_x + 0.5f);
        return value * (place == 2 || place == 4 ? -0.0625f : place == 3 ? -0.125f : place == 12 ? 0.125f : 1.0f);
    };
    const int n = 0;
"""
"""A frozen Gaussian in the place of one of a batch."""

AMONG = f"""
    const int members = among.members.shape[0];
    auto member = [&](int at) -> const float* {{ return (const float*)&among.records.data[among.members.data[at]]; }};
    auto fetch = [&](int at) -> void {{ if (at < members) __builtin_prefetch(member(at)); }};
    auto first_of = [&](int b) -> int {{ return 16 * tile + b ? among.ends.data[16 * tile + b - 1] : 0; }};
    int next[16] = {{}}, last[16] = {{}};  // of each block: the member that its light meets next; one past the last
    alignas(64) float ahead[16];  // how deep the next is
    *(block*)ahead = zero + __builtin_inff();
    auto look_ahead = [&](int b, int at) -> void {{
        next[b] = at;
        ahead[b] = at < last[b] ? member(at)[9] : __builtin_inff();
    }};
    for (int b = 0; members && b < 16; ++b) {{
        last[b] = among.ends.data[16 * tile + b];
        for (int at = first_of(b), k = 0; at < last[b] && k < {_AHEAD}; ++at, ++k) fetch(at);
        look_ahead(b, first_of(b));
    }}
"""
"""Where the light of each block is among the frozen Gaussians."""

DRAW_AMONG = f"""
    // the members of block b from ``at`` on, before ``end``, that are nearer than ``until``; where that ends
    auto draw_among = [&](int b, int at, int end, float until, block& light, block& red, block& green, block& blue,
                          block& depth) __attribute__((always_inline)) -> int {{
        for (; at < end && member(at)[9] < until; ++at) {{
            fetch(at + {_AHEAD});
{_MEMBER}
{MEETING}
{GIVING}
        }}
        return at;
    }};
    // what lies behind block b, once its last splat is drawn
    auto behind = [&](int b, block* color) -> const float* {{
        const float* const rest = has_back ? back : nullptr;
        if (next[b] == last[b]) return rest;
        const float endless = __builtin_inff();
        const int rounded = first_of(b) + (next[b] - first_of(b) + {_KEPT - 1}) / {_KEPT} * {_KEPT};
        const int end = rounded < last[b] ? rounded : last[b];
        draw_among(b, next[b], end, endless, T[b], color[0], color[1], color[2], color[3]);
        if (end == last[b]) return rest;
        int& begin = among.begins.data[16 * tile + b];
        if (begin != end) {{
            begin = end;
            block light = one, c[4] = {{}};
            draw_among(b, begin, last[b], endless, light, c[0], c[1], c[2], c[3]);
            for (int k = 0; k < 4; ++k) store(among.back.data, k, b, rest ? c[k] + light * load(rest, k, b) : c[k]);
            store(among.back.data, 4, b, 1.0f - (rest ? light * (1.0f - load(rest, 4, b)) : light));
        }}
        return among.back.data;
    }};
"""

SPEND_AMONG = f"""
    // light and what it is still to bring (see the adjoint), past the members of block b nearer than ``until``
    auto spend_among = [&](int b, float until) __attribute__((always_inline)) -> void {{
        int at = next[b];
        block light = T[b], left = rest[b];
        for (; at < last[b] && member(at)[9] < until; ++at) {{
            fetch(at + {_AHEAD});
{_MEMBER}
{MEETING}
            block q = v[b][4];
            for (int c = 0; c < 4; ++c) q += v[b][c] * number(6 + c, n);
            left -= w * q;
            light -= w;
        }}
        T[b] = light, rest[b] = left;
        look_ahead(b, at);
    }};
"""


@wp.func_native(f"""
{PRELUDE}
    int sizes[16] = {{}};
    for (int first = begin; first < end; first += 16) {{
{BATCH}
        for (unsigned blocks = alive; blocks; blocks &= blocks - 1) {{
            const int b = __builtin_ctz(blocks), all = 16 * tile + b, place = all ? ends.data[all - 1] : 0;
            for (unsigned which = reached[b]; which; which &= which - 1) {{
                const int n = __builtin_ctz(which);
                const block light = T[b];
{MEETING}
                if (!bits(kept)) continue;
                T[b] = light - w;
                if (members.shape[0]) members.data[place + sizes[b]] = gaussians[isects[first + n]];
                ++sizes[b];
            }}
        }}
    }}
    if (!members.shape[0]) for (int b = 0; b < 16; ++b) ends.data[16 * tile + b] = sizes[b];
""")
def deal_tile(
    tile: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    ends: wp.array(dtype=int),
    members: wp.array(dtype=int),
    image: wp.array(dtype=float),
):
    """Count the members of each block of a tile, or write them where there is room for any."""


@wp.kernel
def deal_among(first: int, canvas: Canvas, bins: Bins, among: Among):
    """Deal the Gaussians that touch a tile to its blocks, see `deal_tile`."""
    deal_tile(first + wp.tid(), canvas, bins, among.records, among.ends, among.members, among.back)
