# type: ignore  (Warp's language, which is not Python's)
"""Projecting, binning and compositing on a CPU: 16x16 tiles, one vector register per block of 4x4 pixels.

Native snippets, because Warp's own scalar loops run an order of magnitude slower here. Both begin with the
same text (`blocks`), so that forward and adjoint see bit-equal alphas and transmittances.
"""

import warp as wp

from dwgs.splat.kernels.among_cpu import AMONG, DRAW_AMONG, SPEND_AMONG, Among
from dwgs.splat.kernels.bin_cpu import allot, count_run, deal_run, sort_tile
from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.blocks import BATCH, GIVING, MEETING, PRELUDE
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.kernels.crew import close_phase, is_leader, open_phase, take
from dwgs.splat.kernels.gather import slot10, sum_slots
from dwgs.splat.kernels.lanes import LANES
from dwgs.splat.kernels.project import Cloud, Lens, project_adjoint_of, project_group, record16

wp.set_module_options({"enable_backward": False})

_FORWARD = f"""
{PRELUDE}
{AMONG}
    auto store = [&](float* to, int channel, int b, block value) {{
        float* at = to + place(channel, b);
        for (int y = 0; y < 4; ++y) *(loose*)(at + y * stride) = *((quarter*)&value + y);
    }};
{DRAW_AMONG}
    block C[16][4];
    block* const more = blocks_of(16 * features);
    for (int b = 0; b < 16; ++b) {{
        for (int c = 0; c < 4; ++c) C[b][c] = has_front ? load(front, c, b) : zero;
        for (int f = 0; f < features; ++f) more[b * features + f] = zero;
    }}
    for (int first = begin; first < end && alive; first += 16) {{
{BATCH}
        for (unsigned blocks = alive; blocks; blocks &= blocks - 1) {{
            const int b = __builtin_ctz(blocks);
            block light = T[b], red = C[b][0], green = C[b][1], blue = C[b][2], depth = C[b][3];
            auto draw_splats = [&](unsigned which) __attribute__((always_inline)) -> void {{
                for (; which; which &= which - 1) {{
                    const int n = __builtin_ctz(which);
{MEETING}
                    if (features) {{
                        const float* feature = feature_of(gaussians[isects[first + n]]);
                        for (int f = 0; f < features; ++f) more[b * features + f] += w * feature[f];
                    }}
{GIVING}
                }}
            }};
            unsigned which = reached[b];
            while (members && which && ahead[b] < number(9, count - 1)) {{  // frozen Gaussians come between
                const unsigned nearer = which & bits(g[9] <= ahead[b]);
                draw_splats(nearer);
                which ^= nearer;
                if (!which) break;
                const float until = number(9, __builtin_ctz(which));
                look_ahead(b, draw_among(b, next[b], last[b], until, light, red, green, blue, depth));
            }}
            draw_splats(which);
            T[b] = light, C[b][0] = red, C[b][1] = green, C[b][2] = blue, C[b][3] = depth;
            alive &= ~((unsigned)(bits(light >= stop) == 0) << b);
        }}
    }}
    for (int b = 0; b < 16; ++b) {{
        const float* const last_of_all = alive >> b & 1 ? behind(b, C[b]) : has_back ? back : nullptr;
        for (int c = 0; c < 4; ++c) {{
            if (last_of_all) C[b][c] += T[b] * load(last_of_all, c, b);
            store(shown, c, b, C[b][c]);
        }}
        if (last_of_all) T[b] *= 1.0f - load(last_of_all, 4, b);
        store(shown, 4, b, 1.0f - T[b]);
        for (int f = 0; f < features; ++f) store(shown, 5 + f, b, more[b * features + f]);
    }}
"""

_ADJOINT = f"""
{PRELUDE}
{AMONG}
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
{SPEND_AMONG}
    int first = begin;
    for (; first < end; first += 16) {{
        unsigned alive = 0;
        for (int b = 0; b < 16; ++b) alive |= (bits(T[b] >= stop) != 0) << b;
        if (!alive) break;
{BATCH}
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
            unsigned late = members ? blocks & bits(*(const block*)ahead < number(9, n)) : 0;
            for (; late; late &= late - 1) spend_among(__builtin_ctz(late), number(9, n));
            block s[10] = {{}};  // of x, y, xx, xy, yy, 1, r, g, b, depth
            for (int f = 0; f < features; ++f) v_f[f] = zero;
            for (; blocks; blocks &= blocks - 1) {{
                const int b = __builtin_ctz(blocks);
                const block light = T[b];
{MEETING}
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
def draw_tile(
    tile: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    among: Among,
    image: wp.array(dtype=float),
):
    """Draw one tile of the image."""


@wp.func_native(_ADJOINT)
def draw_tile_adjoint(
    tile: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    among: Among,
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
    among: Among,
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
            draw_tile(tile, canvas, bins, records, among, image)
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
    among: Among,
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
        draw_tile_adjoint(tile, canvas, bins, records, among, image, v_image, trainable, slots, feature_slots)
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
