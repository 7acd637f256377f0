# type: ignore  (Warp's language, which is not Python's)
"""Projecting, binning and compositing on a CPU: 16x16 tiles, one vector register per block of 4x4 pixels.

Native snippets, because Warp's own scalar loops run an order of magnitude slower here. Both begin with the
same text, so that forward and adjoint see bit-equal alphas and transmittances.
"""

from math import log

import warp as wp

from dwgs.splat.constants import MAX_ALPHA, MIN_ALPHA, STOP_TRANSMITTANCE
from dwgs.splat.kernels.bin_cpu import allot, count_run, deal_run, sort_tile
from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.kernels.crew import close_phase, is_leader, open_phase, take
from dwgs.splat.kernels.gather import slot10, sum_slots
from dwgs.splat.kernels.lanes import LANES, TRANSPOSE
from dwgs.splat.kernels.project import Cloud, Lens, project_adjoint_of, project_group, record16

wp.set_module_options({"enable_backward": False})

_PRELUDE = f"""
    #pragma clang fp contract(on)
    typedef float block __attribute__((vector_size(64)));
    typedef float quarter __attribute__((vector_size(16)));
    typedef float loose __attribute__((vector_size(16), aligned(4)));
    typedef int mask __attribute__((vector_size(64)));
    #define blocks_of(count) ((block*)__builtin_alloca_with_align(((count) + 1) * sizeof(block), 512))
    const block zero = {{}}, one = zero + 1.0f;
    const float slack = 0.01f;  // [px] no rounding hides a block that an ellipse touches
    const block lane_x = {{0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3}};
    const block lane_y = {{0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3}};
    block pixel_x[16], pixel_y[16];  // of each block, from the tile's first
    for (int b = 0; b < 16; ++b) pixel_x[b] = lane_x + b % 4 * 4.0f, pixel_y[b] = lane_y + b / 4 * 4.0f;
    // numbers the compiler cannot see through stay in registers; known ones it would fetch anew for every block
    const float numerals[] = {{
        {MAX_ALPHA}f, {log(MIN_ALPHA) / 8!r}f, {STOP_TRANSMITTANCE}f, 0.0009785861979464097f, 0.007956781442508665f,
        0.041488791404835496f, 0.16662265143851523f, 0.4999947266087482f, 0.9999997586655688f, 0.9999999981506821f,
    }};
    const float* numeral = numerals;
    __asm__("" : "+r"(numeral) : : "memory");
    const block max_alpha = zero + numeral[0], cut = zero + numeral[1], stop = zero + numeral[2];
    const block e6 = zero + numeral[3], e5 = zero + numeral[4], e4 = zero + numeral[5], e3 = zero + numeral[6];
    const block e2 = zero + numeral[7], e1 = zero + numeral[8], e0 = zero + numeral[9];

    const int width = canvas.width, height = canvas.height;
    const bool has_front = canvas.has_front, has_back = canvas.has_back;
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
    auto lower = [](block a, block b) -> block {{ return a < b ? a : b; }};
    auto higher = [](block a, block b) -> block {{ return a > b ? a : b; }};
    auto reciprocal = [&](block x) -> block {{
        #if defined(__AVX512F__)
        const block r = __builtin_ia32_rcp14ps512_mask(x, zero, -1);  // good to 2^-14; a step of Newton's to 2^-28
        return r * (2.0f - x * r);
        #else
        return 1.0f / x;
        #endif
    }};
{TRANSPOSE}
    // exp(8 u) for u in [-0.7, 0], all that the cut at 1/255 lets pass: the eighth power of a polynomial fitted to
    // exp there, good to 2e-9 (its Taylor series would be good to 1e-5); elsewhere the result is any number
    auto exp8 = [&](block u) -> block {{
        #pragma clang fp contract(on)
        block e = u * e6 + e5;
        e = e * u + e4;
        e = e * u + e3;
        e = e * u + e2;
        e = e * u + e1;
        e = e * u + e0;
        e *= e;
        e *= e;
        return e * e;
    }};

    block T[16];
    unsigned alive = 0;  // blocks where a pixel takes light
    for (int b = 0; b < 16; ++b) {{
        const mask inside = (pixel_x[b] < (float)columns) & (pixel_y[b] < (float)rows);
        T[b] = inside ? (has_front ? load(front, 4, b) : one) : zero;
        alive |= (bits(T[b] >= stop) != 0) << b;
    }}
"""
"""Names both loops share. Pixels outside the image start without light."""

_BATCH = """
    const int count = end - first < 16 ? end - first : 16;
    for (int k = first + 16; k < first + 32 && k < end; ++k)
        __builtin_prefetch(&records.data[gaussians[isects[k]]]);  // they lie anywhere
    block g[16] = {};  // one number of all sixteen, by its place in a record
    for (int n = 0; n < count; ++n)
        __builtin_memcpy(g + n, &records.data[gaussians[isects[first + n]]], sizeof(block));
    transpose(g);
    g[0] -= tile_x + 0.5f, g[1] -= tile_y + 0.5f;
    g[2] *= -0.0625f, g[3] *= -0.125f, g[4] *= -0.0625f, g[12] *= 0.125f;  // of the exponent / 8
    const float* const numbers = (const float*)g;
    auto number = [&](int place, int n) -> float { return numbers[16 * place + n]; };
    alignas(64) int reached[16];  // by block, a bit for each Gaussian whose ellipse alpha = 1/255 touches it
    const block mean_x = g[0], mean_y = g[1], extent = g[10], tilt = g[13], summit = g[14], waist = g[15];
    const block per_extent = 1.0f / extent;
    for (int strip = 0; strip < 4; ++strip) {
        const block left = 4.0f * strip - mean_x, right = left + 3.0f;
        const block to_top = lower(higher(summit, left), right), to_bottom = lower(higher(-summit, left), right);
        const block top_x = to_top * per_extent, bottom_x = to_bottom * per_extent;
        const block rise = waist * __builtin_elementwise_sqrt(higher(1.0f - top_x * top_x, zero));
        const block fall = waist * __builtin_elementwise_sqrt(higher(1.0f - bottom_x * bottom_x, zero));
        const block top = tilt * to_top + rise + (mean_y + slack), bottom = tilt * to_bottom - fall + (mean_y - slack);
        const unsigned across = bits((right >= -extent - slack) & (left <= extent + slack));
        for (int row = 0; row < 4; ++row)
            reached[4 * row + strip] = across & bits((bottom <= 4.0f * row + 3.0f) & (top >= 4.0f * row));
    }
    *(mask*)reached &= (1 << count) - 1;
"""
"""Sixteen Gaussians at a time.

Over each of the four strips of columns an ellipse reaches from its lowest to its highest point: those of the whole
if they are in the strip, else at the strip's nearer end.
"""

_MEETING = """
    const block u_0 = number(12, n) - zero;
    const block dx = pixel_x[b] - number(0, n), dy = pixel_y[b] - number(1, n);
    block u = dx * (dx * number(2, n) + dy * number(3, n)) + (dy * (dy * number(4, n)) + u_0);
    u = lower(u, u_0);  // rounding must not lift a needle above its opacity
    const block raw = exp8(u);
    const mask kept = (u >= cut) & (light >= stop);
    const block alpha = lower(raw, max_alpha), w = kept ? light * alpha : zero;
"""
"""Gaussian n meets the sixteen pixels of block b."""

_FORWARD = f"""
{_PRELUDE}
    block C[16][4];
    block* const more = blocks_of(16 * features);
    for (int b = 0; b < 16; ++b) {{
        for (int c = 0; c < 4; ++c) C[b][c] = has_front ? load(front, c, b) : zero;
        for (int f = 0; f < features; ++f) more[b * features + f] = zero;
    }}
    for (int first = begin; first < end && alive; first += 16) {{
{_BATCH}
        for (unsigned blocks = alive; blocks; blocks &= blocks - 1) {{
            const int b = __builtin_ctz(blocks);
            block light = T[b], red = C[b][0], green = C[b][1], blue = C[b][2], depth = C[b][3];
            for (unsigned which = reached[b]; which; which &= which - 1) {{
                const int n = __builtin_ctz(which);
{_MEETING}
                red += w * number(6, n);
                green += w * number(7, n);
                blue += w * number(8, n);
                depth += w * number(9, n);
                if (features) {{
                    const float* feature = feature_of(gaussians[isects[first + n]]);
                    for (int f = 0; f < features; ++f) more[b * features + f] += w * feature[f];
                }}
                light -= w;
            }}
            T[b] = light, C[b][0] = red, C[b][1] = green, C[b][2] = blue, C[b][3] = depth;
            alive &= ~((unsigned)(bits(light >= stop) == 0) << b);
        }}
    }}
    auto store = [&](int channel, int b, block value) {{
        float* at = shown + place(channel, b);
        for (int y = 0; y < 4; ++y) *(loose*)(at + y * stride) = *((quarter*)&value + y);
    }};
    for (int b = 0; b < 16; ++b) {{
        for (int c = 0; c < 4; ++c) {{
            if (has_back) C[b][c] += T[b] * load(back, c, b);
            store(c, b, C[b][c]);
        }}
        if (has_back) T[b] *= 1.0f - load(back, 4, b);
        store(4, b, 1.0f - T[b]);
        for (int f = 0; f < features; ++f) store(5 + f, b, more[b * features + f]);
    }}
"""

_ADJOINT = f"""
{_PRELUDE}
    auto fold = [&](block a, block b) -> block {{ return first_halves(a, b) + last_halves(a, b); }};
    auto sums = [&](const block* v) -> block {{  // of ten blocks in one go, in the first ten lanes
        const block even = fold(fold(fold(v[0], v[5]), fold(v[3], v[8])), fold(fold(v[2], v[7]), zero));
        const block odd = fold(fold(fold(v[1], v[6]), fold(v[4], v[9])), zero);
        const block all = fold(even, odd);
        return __builtin_shufflevector(all, all, 0, 1, 2, 4, 5, 8, 9, 10, 12, 13, 3, 3, 3, 3, 3, 3);
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
            if (has_front) behind -= c < 4 ? load(front, c, b) : 1.0f - T[b];
            rest[b] += v[b][c] * behind;
        }}
        for (int f = 0; f < features; ++f) {{
            v_more[b * features + f] = gradient(v_image.features, f, b);
            rest[b] += v_more[b * features + f] * load(shown, 5 + f, b);
        }}
    }}
    int first = begin;
    for (; first < end; first += 16) {{
        unsigned alive = 0;
        for (int b = 0; b < 16; ++b) alive |= (bits(T[b] >= stop) != 0) << b;
        if (!alive) break;
{_BATCH}
        for (int n = 0; n < count; ++n) {{  // the lines a slot lies in
            const char* slot = (const char*)&slots.data[isects[first + n]];
            __builtin_prefetch(slot, 1);
            __builtin_prefetch(slot + sizeof(slots.data[0]) - 1, 1);
        }}
        for (int n = 0; n < count; ++n) {{
            const int isect = isects[first + n];
            const bool frozen = gaussians[isect] - view * canvas.gaussians >= trainable;
            unsigned blocks = alive & bits((*(mask*)reached & 1 << n) != 0);
            if (!blocks) {{
                if (!frozen) clear(isect);
                continue;
            }}
            const float* feature = feature_of(gaussians[isect]);
            block s[10] = {{}};  // of x, y, xx, xy, yy, 1, r, g, b, depth
            for (int f = 0; f < features; ++f) v_f[f] = zero;
            for (; blocks; blocks &= blocks - 1) {{
                const int b = __builtin_ctz(blocks);
                const block light = T[b];
{_MEETING}
                block q = v[b][4];
                for (int c = 0; c < 4; ++c) q += v[b][c] * number(6 + c, n);
                for (int f = 0; f < features; ++f) q += v_more[b * features + f] * feature[f];
                rest[b] -= w * q;
                T[b] = light - w;
                if (frozen) continue;
                const block slope = w * q - rest[b] * (alpha * reciprocal(1.0f - alpha));
                const block v_power = (kept & (raw < max_alpha)) ? slope : zero;  // the clamp passes no gradient
                const block by_x = v_power * dx, by_y = v_power * dy;
                s[0] += by_x;
                s[1] += by_y;
                s[2] += by_x * dx;
                s[3] += by_x * dy;
                s[4] += by_y * dy;
                s[5] += v_power;
                for (int c = 0; c < 4; ++c) s[6 + c] += w * v[b][c];
                for (int f = 0; f < features; ++f) v_f[f] += w * v_more[b * features + f];
            }}
            if (frozen) continue;
            const block m = sums(s);
            const float xx = -16.0f * number(2, n), xy = -8.0f * number(3, n), yy = -16.0f * number(4, n);
            const block own = {{xx, yy, -0.5f, -1.0f, -0.5f, 1.0f / number(5, n), 1.0f, 1.0f, 1.0f, 1.0f}};
            const block other = {{xy, xy}};
            const block swapped = __builtin_shufflevector(m, m, 1, 0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            const block value = own * m + other * swapped;
            __builtin_memcpy(&slots.data[isect], &value, sizeof(slots.data[0]));
            float* feature_slot = feature_slots.data + isect * (long long)features;
            for (int f = 0; f < features; ++f) {{
                block total[10] = {{v_f[f]}};
                feature_slot[f] = sums(total)[0];
            }}
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


GATHERED = 256
"""Gaussians that are projected, or whose slots are summed, as one item."""
_LANES = LANES["cpu"]
_GROUPS = GATHERED // _LANES


@wp.kernel
def composite(
    crew: wp.array(dtype=int),
    cloud: Cloud,
    lens: Lens,
    canvas: Canvas,
    bins: Bins,
    run_size: int,
    # outputs
    records: wp.array(dtype=record16),
    ends: wp.array(dtype=int),
    places: wp.array2d(dtype=int),
    depths: wp.array(dtype=float),
    spare_depths: wp.array(dtype=float),
    spare_isects: wp.array(dtype=int),
    image: wp.array(dtype=float),
    total: wp.array(dtype=int),
):
    """Project, bin by runs of Gaussians, sort and draw by tiles, once per thread of the crew.

    In each view the cloud's records come first; those behind them are there already. Without an image nothing is
    drawn; without room for the ``total`` of intersections nothing but that is found.
    """
    leads = is_leader(crew)
    groups = lens.intrinsics.shape[0] * ((cloud.means.shape[0] + _LANES - 1) / _LANES)
    open_phase(crew, 0, leads, (groups + _GROUPS - 1) / _GROUPS)
    some = take(crew, 0, leads, -1)
    while some >= 0:
        for group in range(some * _GROUPS, wp.min((some + 1) * _GROUPS, groups)):
            project_group(group, cloud, lens, canvas.gaussians, records)
        some = take(crew, 0, leads, some)
    close_phase(crew, 0, leads)

    tiles = wp.vec2i(canvas.tiles_across, canvas.tiles_down)
    open_phase(crew, 1, leads, places.shape[0])
    run = take(crew, 1, leads, -1)
    while run >= 0:
        count_run(run, run_size, records, canvas.gaussians, tiles, ends, places)
        run = take(crew, 1, leads, run)
    close_phase(crew, 1, leads)

    is_room = True
    if leads:
        total[0] = allot(ends, places, bins.ranges)
        is_room = total[0] <= depths.shape[0]
    open_phase(crew, 2, leads, places.shape[0] * int(is_room))
    run = take(crew, 2, leads, -1)
    while run >= 0:
        deal_run(
            run,
            run_size,
            records,
            canvas.gaussians,
            tiles,
            ends,
            places,
            depths,
            bins.isect_from_sorted,
            bins.gaussian_from_isect,
        )
        run = take(crew, 2, leads, run)
    close_phase(crew, 2, leads)

    open_phase(crew, 3, leads, bins.ranges.shape[0] * int(is_room))
    tile = take(crew, 3, leads, -1)
    while tile >= 0:
        sort_tile(tile, bins.ranges, depths, bins.isect_from_sorted, spare_depths, spare_isects)
        if image.shape[0] > 0:
            draw_tile(tile, canvas, bins, records, image)
        tile = take(crew, 3, leads, tile)
    close_phase(crew, 3, leads)


@wp.kernel
def composite_adjoint(
    crew: wp.array(dtype=int),
    cloud: Cloud,
    lens: Lens,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    v_image: Gradient,
    trainable: int,
    ends: wp.array(dtype=int),
    spans: wp.array(dtype=wp.vec2i),
    # outputs
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
    v_records: wp.array(dtype=record16),
    v_features: wp.array2d(dtype=float),
    v_cloud: Cloud,
    v_viewmats: wp.array2d(dtype=wp.mat44),
):
    """Slots by tiles, their sums by Gaussians, the cloud's gradient by ``spans``, once per thread of the crew."""
    leads = is_leader(crew)
    open_phase(crew, 0, leads, bins.ranges.shape[0])
    tile = take(crew, 0, leads, -1)
    while tile >= 0:
        draw_tile_adjoint(tile, canvas, bins, records, image, v_image, trainable, slots, feature_slots)
        tile = take(crew, 0, leads, tile)
    close_phase(crew, 0, leads)

    open_phase(crew, 1, leads, (ends.shape[0] + GATHERED - 1) / GATHERED)
    some = take(crew, 1, leads, -1)
    while some >= 0:
        for i in range(some * GATHERED, wp.min((some + 1) * GATHERED, ends.shape[0])):
            sum_slots(
                i, slots, feature_slots, ends, canvas.gaussians, trainable, canvas.features, v_records, v_features
            )
        some = take(crew, 1, leads, some)
    close_phase(crew, 1, leads)

    open_phase(crew, 2, leads, spans.shape[0])
    span = take(crew, 2, leads, -1)
    while span >= 0:
        project_adjoint_of(span, cloud, lens, canvas.gaussians, records, v_records, spans, v_cloud, v_viewmats)
        span = take(crew, 2, leads, span)
    close_phase(crew, 2, leads)
