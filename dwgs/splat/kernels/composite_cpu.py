# type: ignore  (Warp's language, which is not Python's)
"""The two compositing loops on a CPU: one task per 16x16 tile, one vector register per row of 16 pixels.

Native snippets, because Warp's own scalar loops run an order of magnitude slower here. Both begin with the
same text, so that forward and adjoint see bit-equal alphas and transmittances.
"""

import warp as wp

from dwgs.splat.constants import MAX_ALPHA, MIN_ALPHA, STOP_TRANSMITTANCE
from dwgs.splat.kernels.bin import Bins
from dwgs.splat.kernels.canvas import Canvas
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.kernels.project import record12

wp.set_module_options({"enable_backward": False})

SLOTS = 1
"""Gradients per intersection: one task sees the whole tile."""

_PRELUDE = f"""
    #pragma clang fp contract(on)
    typedef float row __attribute__((vector_size(64)));
    typedef float loose __attribute__((vector_size(64), aligned(4)));
    typedef int mask __attribute__((vector_size(64)));
    const row zero = {{}};
    const row column = {{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}};
    const float max_alpha = {MAX_ALPHA}f, min_alpha = {MIN_ALPHA!r}f, stop = {STOP_TRANSMITTANCE}f;

    const int width = canvas.width, height = canvas.height;
    const bool layered = canvas.layered;
    const float *front = canvas.front.data, *back = canvas.back.data;
    const int stride = canvas.tiles_across * 16;
    const int tile_x = tile % canvas.tiles_across * 16, tile_y = tile / canvas.tiles_across * 16;
    const int plane = stride * ((height + 15) / 16 * 16);
    const int corner = tile_y * stride + tile_x;
    const int rows = height - tile_y < 16 ? height - tile_y : 16;
    const int *isects = bins.isect_from_sorted.data, *gaussians = bins.gaussian_from_isect.data;
    const row px = column + (tile_x + 0.5f);
    const int begin = bins.ranges.data[tile][0], end = bins.ranges.data[tile][1];

    auto load = [&](const float* image, int channel, int y) -> row {{
        return *(const loose*)(image + channel * plane + corner + y * stride);
    }};
    auto any = [](mask m) -> bool {{
        typedef long long half __attribute__((vector_size(32)));
        const half h = *(half*)&m | *((half*)&m + 1);
        return (h[0] | h[1] | h[2] | h[3]) != 0;
    }};

    // exp(8 u) for u in [-0.7, 0], which the cut at 1/255 never leaves: the eighth power of a polynomial
    // fitted to exp there, good to 1e-7 (its Taylor series would be good to 1e-4)
    auto exp8 = [&](row u) -> row {{
        #pragma clang fp contract(on)
        const row low = zero - 0.7f;
        u = u > low ? u : low;
        u = u < zero ? u : zero;
        row e = u * 0.005846760179652792f + 0.03977256183882582f;
        e = e * u + 0.165973975498052f;
        e = e * u + 0.4998825873621815f;
        e = e * u + 0.9999925393133835f;
        e = e * u + 0.9999999205129144f;
        e *= e;
        e *= e;
        return e * e;
    }};

    row T[16];
    bool alive[16];
    for (int y = 0; y < rows; ++y) {{
        const row one = zero + 1.0f;
        T[y] = layered ? load(front, 4, y) : (px < (float)width ? one : zero);
    }}
"""
"""Names both loops share. Columns outside the image start without light, rows outside are never visited."""

_GAUSSIAN = """
        if ((k - begin) % 16 == 0) {
            bool lit = false;
            for (int y = 0; y < rows; ++y) lit |= alive[y] = any(T[y] >= stop);
            if (!lit) break;
        }
        const int isect = isects[k], gaussian = gaussians[isect];
        if (k + 8 < end) __builtin_prefetch(&records.data[gaussians[isects[k + 8]]]);  // they lie anywhere
        const float* g = (const float*)&records.data[gaussian];
        const row dx = px - g[0];
        const row u_x = dx * dx * (-0.0625f * g[2]);
        const row u_xy = dx * (-0.125f * g[3]);
        const float u_y = -0.0625f * g[4];
        const float above = g[1] - g[11] - 0.5f - tile_y, below = g[1] + g[11] - 0.5f - tile_y;
        const int y_begin = above > 0.0f ? (int)__builtin_ceilf(above) : 0;
        const int y_end = below < rows - 1 ? (int)__builtin_floorf(below) + 1 : rows;
"""
"""One Gaussian: what does not change from row to row; rows that its extent does not reach are not visited."""

_PIXELS = """
            if (!alive[y]) continue;
            const float dy = (tile_y + y + 0.5f) - g[1];
            const row e = exp8(u_x + dy * (u_xy + dy * u_y));
            const row raw = e * g[5];
            const mask kept = (raw >= min_alpha) & (T[y] >= stop);
            const row clamped = raw < max_alpha ? raw : zero + max_alpha;
            const row alpha = kept ? clamped : zero;
            const row w = T[y] * alpha;
"""
"""Sixteen pixels meet one Gaussian."""

_FORWARD = f"""
{_PRELUDE}
    row C[16][4];
    for (int y = 0; y < rows; ++y)
        for (int c = 0; c < 4; ++c) C[y][c] = layered ? load(front, c, y) : zero;
    for (int k = begin; k < end; ++k) {{
{_GAUSSIAN}
        for (int y = y_begin; y < y_end; ++y) {{
{_PIXELS}
            for (int c = 0; c < 4; ++c) C[y][c] += w * g[6 + c];
            T[y] -= w;
        }}
    }}
    for (int y = 0; y < rows; ++y) {{
        for (int c = 0; c < 4; ++c) {{
            if (layered) C[y][c] += T[y] * load(back, c, y);
            *(loose*)(image.data + c * plane + corner + y * stride) = C[y][c];
        }}
        if (layered) T[y] *= 1.0f - load(back, 4, y);
        *(loose*)(image.data + 4 * plane + corner + y * stride) = 1.0f - T[y];
    }}
"""

_ADJOINT = f"""
{_PRELUDE}
    typedef float half __attribute__((vector_size(32)));
    typedef float quarter __attribute__((vector_size(16)));
    auto fold = [](row r) -> quarter {{
        const half h = *(half*)&r + *((half*)&r + 1);
        return *(quarter*)&h + *((quarter*)&h + 1);
    }};
    auto pair = [](quarter a, quarter b) -> quarter {{
        return __builtin_shufflevector(a, b, 0, 4, 1, 5) + __builtin_shufflevector(a, b, 2, 6, 3, 7);
    }};
    auto sums = [&](row r0, row r1, row r2, row r3) -> quarter {{  // of four rows in one go
        const quarter a = pair(fold(r0), fold(r1)), b = pair(fold(r2), fold(r3));
        return __builtin_shufflevector(a, b, 0, 1, 4, 5) + __builtin_shufflevector(a, b, 2, 3, 6, 7);
    }};

    // what the light still to come brings to the loss: known in full at the start, spent Gaussian by Gaussian
    row rest[16], v[16][5];
    for (int y = 0; y < rows; ++y) {{
        rest[y] = zero;
        for (int c = 0; c < 5; ++c) {{
            v[y][c] = load(v_image.data, c, y);
            row behind = load(image.data, c, y);
            if (layered) behind -= c < 4 ? load(front, c, y) : 1.0f - T[y];
            rest[y] += v[y][c] * behind;
        }}
    }}
    int k = begin;
    for (; k < end; ++k) {{
{_GAUSSIAN}
        const bool frozen = gaussian >= trainable;
        row s = zero, s_y = zero, s_yy = zero, v_c[4] = {{}};
        mask touched = {{}};
        for (int y = y_begin; y < y_end; ++y) {{
{_PIXELS}
            const row q = v[y][0] * g[6] + v[y][1] * g[7] + v[y][2] * g[8] + v[y][3] * g[9] + v[y][4];
            rest[y] -= w * q;
            T[y] -= w;
            if (frozen) continue;
            touched |= kept;
            const row slope = w * q - rest[y] * alpha / (1.0f - alpha);
            const row v_power = raw < max_alpha ? slope : zero;  // the clamp at max_alpha passes no gradient
            s += v_power;
            const row by_y = v_power * dy;
            s_y += by_y;
            s_yy += by_y * dy;
            for (int c = 0; c < 4; ++c) v_c[c] += w * v[y][c];
        }}
        if (frozen) continue;
        float* slot = (float*)&slots.data[isect];
        if (!any(touched)) {{
            for (int j = 0; j < 10; ++j) slot[j] = 0.0f;
            continue;
        }}
        const row s_x = s * dx;
        const quarter m1 = sums(s_x, s_y, s_x * dx, s_y * dx);
        const quarter m0 = sums(s, s_yy, zero, zero);
        const quarter color = sums(v_c[0], v_c[1], v_c[2], v_c[3]);
        slot[0] = g[2] * m1[0] + g[3] * m1[1];
        slot[1] = g[3] * m1[0] + g[4] * m1[1];
        slot[2] = -0.5f * m1[2];
        slot[3] = -m1[3];
        slot[4] = -0.5f * m0[1];
        slot[5] = m0[0] / g[5];
        for (int c = 0; c < 4; ++c) slot[6 + c] = color[c];
    }}
    for (; k < end; ++k) {{  // behind the last light
        float* slot = (float*)&slots.data[isects[k]];
        for (int j = 0; j < 10; ++j) slot[j] = 0.0f;
    }}
"""


@wp.func_native(_FORWARD)
def draw_tile(tile: int, canvas: Canvas, bins: Bins, records: wp.array(dtype=record12), image: wp.array(dtype=float)):
    """Draw one tile of the image."""


@wp.func_native(_ADJOINT)
def draw_tile_adjoint(
    tile: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record12),
    image: wp.array(dtype=float),
    v_image: wp.array(dtype=float),
    trainable: int,
    slots: wp.array(dtype=slot10),
):
    """Write the slot of each intersection of one tile."""


@wp.kernel
def composite(
    first: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record12),
    # outputs
    image: wp.array(dtype=float),
):
    """One task per tile."""
    draw_tile(first + wp.tid(), canvas, bins, records, image)


@wp.kernel
def composite_adjoint(
    first: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record12),
    image: wp.array(dtype=float),
    v_image: wp.array(dtype=float),
    trainable: int,
    # outputs
    slots: wp.array(dtype=slot10),
):
    """One task per tile; slots of Gaussians from ``trainable`` on are left as they are."""
    draw_tile_adjoint(first + wp.tid(), canvas, bins, records, image, v_image, trainable, slots)
