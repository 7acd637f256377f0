# type: ignore  (Warp's language, which is not Python's)
"""The two compositing loops on a CPU: one task per 16x16 tile, one vector register per block of 4x4 pixels.

Native snippets, because Warp's own scalar loops run an order of magnitude slower here. Both begin with the
same text, so that forward and adjoint see bit-equal alphas and transmittances.
"""

from math import log

import warp as wp

from dwgs.splat.constants import MAX_ALPHA, MIN_ALPHA, STOP_TRANSMITTANCE
from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

SLOTS = 1
"""Gradients per intersection: one task sees the whole tile."""

_PRELUDE = f"""
    #pragma clang fp contract(on)
    typedef float block __attribute__((vector_size(64)));
    typedef float half __attribute__((vector_size(32)));
    typedef float quarter __attribute__((vector_size(16)));
    typedef float loose __attribute__((vector_size(16), aligned(4)));
    typedef int mask __attribute__((vector_size(64)));
    #define blocks_of(count) ((block*)__builtin_alloca_with_align(((count) + 1) * sizeof(block), 512))
    const block zero = {{}}, one = zero + 1.0f;
    const float slack = 0.01f;  // [px] no rounding hides a block that an ellipse touches
    const block lane_x = {{0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3}};
    const block lane_y = {{0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3}};
    const block strip_x = 4.0f * lane_x, strip_y = 4.0f * lane_y;  // of block b, in lane b
    const float max_alpha = {MAX_ALPHA}f, cut = {log(MIN_ALPHA) / 8!r}f, stop = {STOP_TRANSMITTANCE}f;

    const int width = canvas.width, height = canvas.height;
    const bool layered = canvas.layered;
    const int stride = canvas.tiles_across * 16, plane = stride * canvas.tiles_down * 16;
    const int view = tile / (canvas.tiles_across * canvas.tiles_down);
    const int inside = tile - view * canvas.tiles_across * canvas.tiles_down;
    const int tile_x = inside % canvas.tiles_across * 16, tile_y = inside / canvas.tiles_across * 16;
    const float *front = canvas.front.data + view * 5ll * plane, *back = canvas.back.data + view * 5ll * plane;
    const int features = canvas.features;
    float* const shown = image.data + view * (5ll + features) * plane;
    auto feature_of = [&](int gaussian) -> const float* {{
        return canvas.feature.data + (gaussian - view * canvas.gaussians) * (long long)features;
    }};
    const int corner = tile_y * stride + tile_x;
    const int columns = width - tile_x < 16 ? width - tile_x : 16, rows = height - tile_y < 16 ? height - tile_y : 16;
    const int *isects = bins.isect_from_sorted.data, *gaussians = bins.gaussian_from_isect.data;
    const int begin = bins.ranges.data[tile][0], end = bins.ranges.data[tile][1];

    auto place = [&](int channel, int b) -> int {{ return channel * plane + corner + b / 4 * 4 * stride + b % 4 * 4; }};
    auto load = [&](const float* image, int channel, int b) -> block {{
        const float* at = image + place(channel, b);
        block value;
        for (int y = 0; y < 4; ++y) *((quarter*)&value + y) = *(const loose*)(at + y * stride);
        return value;
    }};
    auto bits = [](mask m) -> unsigned {{  // one for each lane
        typedef bool flags __attribute__((ext_vector_type(16)));
        const flags f = __builtin_convertvector(m, flags);
        unsigned short b;
        __builtin_memcpy(&b, &f, 2);
        return b;
    }};
    auto root = [](quarter x) -> quarter {{
        const quarter none = {{}};
        return __builtin_elementwise_sqrt(x > none ? x : none);
    }};
    auto reciprocal = [&](block x) -> block {{
        #if defined(__AVX512F__)
        const block r = __builtin_ia32_rcp14ps512_mask(x, zero, -1);  // good to 2^-14; a step of Newton's to 2^-28
        return r * (2.0f - x * r);
        #else
        return 1.0f / x;
        #endif
    }};
    auto four = [](quarter q) -> block {{
        return __builtin_shufflevector(q, q, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3);
    }};

    // exp(8 u) for u in [-0.7, 0], all that the cut at 1/255 lets pass: the eighth power of a polynomial fitted to
    // exp there, good to 2e-9 (its Taylor series would be good to 1e-5); elsewhere the result is any number
    auto exp8 = [&](block u) -> block {{
        #pragma clang fp contract(on)
        block e = u * 0.0009785861979464097f + 0.007956781442508665f;
        e = e * u + 0.041488791404835496f;
        e = e * u + 0.16662265143851523f;
        e = e * u + 0.4999947266087482f;
        e = e * u + 0.9999997586655688f;
        e = e * u + 0.9999999981506821f;
        e *= e;
        e *= e;
        return e * e;
    }};

    block T[16];
    unsigned alive = 0;  // blocks where a pixel takes light
    for (int b = 0; b < 16; ++b) {{
        const mask inside = (lane_x + strip_x[b] < (float)columns) & (lane_y + strip_y[b] < (float)rows);
        T[b] = inside ? (layered ? load(front, 4, b) : one) : zero;
        alive |= (bits(T[b] >= stop) != 0) << b;
    }}
"""
"""Names both loops share. Pixels outside the image start without light."""

_BATCH = """
    const float* batch[16];
    unsigned reached[16];  // blocks that the ellipse alpha = 1/255 of a Gaussian touches
    const int count = end - first < 16 ? end - first : 16;
    if (first > begin) {
        for (int b = 0; b < 16; ++b) alive &= ~((unsigned)(bits(T[b] >= stop) == 0) << b);
        if (!alive) break;
    }
    for (int k = first + 16; k < first + 32 && k < end; ++k)
        __builtin_prefetch(&records.data[gaussians[isects[k]]]);  // they lie anywhere
    for (int n = 0; n < count; ++n) {
        const float* g = batch[n] = (const float*)&records.data[gaussians[isects[first + n]]];
        const float x = g[0] - 0.5f - tile_x, y = g[1] - 0.5f - tile_y;
        const quarter left = (quarter){0, 4, 8, 12} - x, right = left + 3.0f, none = {};
        auto within = [&](float dx) -> quarter {
            const quarter above = none + dx > left ? none + dx : left;
            return above < right ? above : right;
        };
        const quarter to_top = within(g[14]), to_bottom = within(-g[14]);
        const quarter top_x = to_top / g[10], bottom_x = to_bottom / g[10];
        const quarter top = g[13] * to_top + g[15] * root(1.0f - top_x * top_x) + (y + slack);
        const quarter bottom = g[13] * to_bottom - g[15] * root(1.0f - bottom_x * bottom_x) + (y - slack);
        const mask across = (strip_x + 3.0f >= x - g[10] - slack) & (strip_x <= x + g[10] + slack);
        reached[n] = alive & bits(across & (strip_y + 3.0f >= four(bottom)) & (strip_y <= four(top)));
    }
"""
"""Sixteen Gaussians at a time, so that the processor need not guess which blocks come next.

Over each of the four strips of columns an ellipse reaches from its lowest to its highest point: those of the whole
if they are in the strip, else at the strip's nearer end.
"""

_GAUSSIAN = """
        const float* g = batch[n];
        const block left_x = lane_x - (g[0] - 0.5f - tile_x), top_y = lane_y - (g[1] - 0.5f - tile_y);
        const float u_xx = -0.0625f * g[2], u_xy = -0.125f * g[3], u_yy = -0.0625f * g[4], u_0 = 0.125f * g[12];
        for (unsigned blocks = reached[n]; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            const block dx = left_x + strip_x[b], dy = top_y + strip_y[b];
            block u = dx * (dx * u_xx + dy * u_xy) + (dy * (dy * u_yy) + u_0);
            u = u < u_0 ? u : zero + u_0;  // rounding must not lift a needle above its opacity
            const block raw = exp8(u);
            const mask kept = (u >= cut) & (T[b] >= stop);
            const block clamped = raw < max_alpha ? raw : zero + max_alpha;
            const block alpha = kept ? clamped : zero;
            const block w = T[b] * alpha;
"""
"""Sixteen pixels meet one Gaussian."""

_FORWARD = f"""
{_PRELUDE}
    block C[16][4];
    block* const more = blocks_of(16 * features);
    for (int b = 0; b < 16; ++b) {{
        for (int c = 0; c < 4; ++c) C[b][c] = layered ? load(front, c, b) : zero;
        for (int f = 0; f < features; ++f) more[b * features + f] = zero;
    }}
    for (int first = begin; first < end; first += 16) {{
{_BATCH}
        for (int n = 0; n < count; ++n) {{
            const float* feature = feature_of(gaussians[isects[first + n]]);
{_GAUSSIAN}
                for (int c = 0; c < 4; ++c) C[b][c] += w * g[6 + c];
                for (int f = 0; f < features; ++f) more[b * features + f] += w * feature[f];
                T[b] -= w;
            }}
        }}
    }}
    auto store = [&](int channel, int b, block value) {{
        float* at = shown + place(channel, b);
        for (int y = 0; y < 4; ++y) *(loose*)(at + y * stride) = *((quarter*)&value + y);
    }};
    for (int b = 0; b < 16; ++b) {{
        for (int c = 0; c < 4; ++c) {{
            if (layered) C[b][c] += T[b] * load(back, c, b);
            store(c, b, C[b][c]);
        }}
        if (layered) T[b] *= 1.0f - load(back, 4, b);
        store(4, b, 1.0f - T[b]);
        for (int f = 0; f < features; ++f) store(5 + f, b, more[b * features + f]);
    }}
"""

_ADJOINT = f"""
{_PRELUDE}
    auto fold = [](block r) -> quarter {{
        const half h = *(half*)&r + *((half*)&r + 1);
        return *(quarter*)&h + *((quarter*)&h + 1);
    }};
    auto pair = [](quarter a, quarter b) -> quarter {{
        return __builtin_shufflevector(a, b, 0, 4, 1, 5) + __builtin_shufflevector(a, b, 2, 6, 3, 7);
    }};
    auto sums = [&](block r0, block r1, block r2, block r3) -> quarter {{  // of four blocks in one go
        const quarter a = pair(fold(r0), fold(r1)), b = pair(fold(r2), fold(r3));
        return __builtin_shufflevector(a, b, 0, 1, 4, 5) + __builtin_shufflevector(a, b, 2, 3, 6, 7);
    }};

    auto clear = [&](int isect) {{
        for (int j = 0; j < 10; ++j) ((float*)&slots.data[isect])[j] = 0.0f;
        for (int f = 0; f < features; ++f) feature_slots.data[isect * (long long)features + f] = 0.0f;
    }};

    auto gradient = [&](const wp::array_t<float>& v, int channel, int b) -> block {{
        const int x = b % 4 * 4, y = b / 4 * 4, step = v.strides[3];
        const char* at = (const char*)v.data + view * (long long)v.strides[0] + channel * (long long)v.strides[1]
            + (tile_y + y) * (long long)v.strides[2] + (tile_x + x) * (long long)step;
        block value = zero;
        for (int row = 0; row < 4 && y + row < rows; ++row, at += v.strides[2])
            if (step == sizeof(float) && x + 4 <= columns) *((quarter*)&value + row) = *(const loose*)at;
            else for (int i = 0; i < 4 && x + i < columns; ++i) value[4 * row + i] = *(const float*)(at + i * step);
        return value;
    }};

    // what the light still to come brings to the loss: known in full at the start, spent Gaussian by Gaussian
    if (begin == end) return;
    block rest[16], v[16][5];
    block *const v_more = blocks_of(16 * features), *const v_f = blocks_of(features);
    for (int b = 0; b < 16; ++b) {{
        rest[b] = zero;
        for (int c = 0; c < 5; ++c) {{
            v[b][c] = c < 3 ? gradient(v_image.rgb, c, b) : gradient(c < 4 ? v_image.depth : v_image.alpha, 0, b);
            block behind = load(shown, c, b);
            if (layered) behind -= c < 4 ? load(front, c, b) : 1.0f - T[b];
            rest[b] += v[b][c] * behind;
        }}
        for (int f = 0; f < features; ++f) {{
            v_more[b * features + f] = gradient(v_image.features, f, b);
            rest[b] += v_more[b * features + f] * load(shown, 5 + f, b);
        }}
    }}
    int first = begin;
    for (; first < end; first += 16) {{
{_BATCH}
        for (int n = 0; n < count; ++n) __builtin_prefetch(&slots.data[isects[first + n]], 1);  // they lie anywhere too
        for (int n = 0; n < count; ++n) {{
            const int isect = isects[first + n];
            const bool frozen = gaussians[isect] - view * canvas.gaussians >= trainable;
            if (!reached[n]) {{
                if (!frozen) clear(isect);
                continue;
            }}
            const float* feature = feature_of(gaussians[isect]);
            block s = zero, s_x = zero, s_y = zero, s_xx = zero, s_xy = zero, s_yy = zero, v_c[4] = {{}};
            for (int f = 0; f < features; ++f) v_f[f] = zero;
{_GAUSSIAN}
                block q = v[b][0] * g[6] + v[b][1] * g[7] + v[b][2] * g[8] + v[b][3] * g[9] + v[b][4];
                for (int f = 0; f < features; ++f) q += v_more[b * features + f] * feature[f];
                rest[b] -= w * q;
                T[b] -= w;
                if (frozen) continue;
                const block slope = w * q - rest[b] * (alpha * reciprocal(1.0f - alpha));
                const block v_power = raw < max_alpha ? slope : zero;  // the clamp passes no gradient
                const block by_x = v_power * dx, by_y = v_power * dy;
                s += v_power;
                s_x += by_x;
                s_y += by_y;
                s_xx += by_x * dx;
                s_xy += by_x * dy;
                s_yy += by_y * dy;
                for (int c = 0; c < 4; ++c) v_c[c] += w * v[b][c];
                for (int f = 0; f < features; ++f) v_f[f] += w * v_more[b * features + f];
            }}
            if (frozen) continue;
            const quarter m1 = sums(s_x, s_y, s_xx, s_xy), m0 = sums(s, s_yy, zero, zero);
            const quarter color = sums(v_c[0], v_c[1], v_c[2], v_c[3]);
            float* slot = (float*)&slots.data[isect];
            slot[0] = g[2] * m1[0] + g[3] * m1[1];
            slot[1] = g[3] * m1[0] + g[4] * m1[1];
            slot[2] = -0.5f * m1[2];
            slot[3] = -m1[3];
            slot[4] = -0.5f * m0[1];
            slot[5] = m0[0] / g[5];
            for (int c = 0; c < 4; ++c) slot[6 + c] = color[c];
            float* feature_slot = feature_slots.data + isect * (long long)features;
            for (int f = 0; f < features; ++f) feature_slot[f] = sums(v_f[f], zero, zero, zero)[0];
        }}
    }}
    for (int k = first; k < end; ++k) clear(isects[k]);  // behind the last light
"""


@wp.func_native(_FORWARD)
def draw_tile(tile: int, canvas: Canvas, bins: Bins, records: wp.array(dtype=record16), image: wp.array(dtype=float)):
    """Draw one tile of the image."""


@wp.func_native(_ADJOINT)
def draw_tile_adjoint(
    tile: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    v_image: Gradient,
    trainable: int,
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
):
    """Write the slots of each intersection of one tile."""


@wp.kernel
def composite(
    first: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
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
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    v_image: Gradient,
    trainable: int,
    # outputs
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
):
    """One task per tile; slots of a view's Gaussians from ``trainable`` on are left as they are."""
    draw_tile_adjoint(first + wp.tid(), canvas, bins, records, image, v_image, trainable, slots, feature_slots)
