# type: ignore  (Warp's language, which is not Python's)
"""The two compositing loops on a GPU: one block per 16x16 tile, one warp per 8x4 pixels of it, one thread per pixel.

A block carries the Gaussians of its tile into shared memory, batch by batch, the next on their way while one is drawn;
a warp lists those that reach its pixels, which `bin_cuda` found out, and draws them. In the adjoint a warp sums its
pixels' gradients by halves, so that twelve shuffles do for ten numbers, and the block sums those of its warps in order:
no atomics, and the same bytes every time. The adjoint walks a crowded tile in segments, a block each, from states that
the first pass kept of its pixels.

The same text runs on a CPU, every pixel being a block, a warp and a lane by itself: slow, but a witness for
everything but the exchange between threads. Launched over tiles (segments in the adjoint) x `BLOCK` threads,
``block_dim=BLOCK``.
"""

import warp as wp

from dwgs.splat import constants
from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

BLOCK = constants.TILE * constants.TILE
"""Threads per tile."""
WARPS = BLOCK // 32
"""Per tile."""
PARTS, FEATURE_PARTS = 1, WARPS
"""Gradients of records and of features per intersection."""
BATCH = 64
"""Gaussians in shared memory at once in the adjoint; `SEGMENT` in the first pass."""
AT_ONCE = 8
"""Gaussians that the first pass draws at once: their alphas need not wait for each other."""
SEGMENT = 128
"""Intersections of a tile after which the state of its pixels is kept, so that the adjoint can begin there."""


def _prelude(batch: int) -> str:
    """What a thread draws, and how it gets at the Gaussians."""
    loaders = 3 if 3 * batch <= BLOCK else 1  # of each Gaussian
    rows = 3 // loaders
    return f"""
    #if defined(__CUDA_ARCH__)
    const int lanes = 32, lane = threadIdx.x % 32;
    auto ballot = [](bool x) -> unsigned {{ return __ballot_sync(~0u, x); }};
    auto ones = [](unsigned x) -> int {{ return __popc(x); }};
    auto exponential = [](float x) -> float {{
        float y;
        asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x * 1.44269504f));
        return y;
    }};
    auto over = [](float x, float y) -> float {{ return __fdividef(x, y); }};
    #else
    const int lanes = 1, lane = 0;
    auto ballot = [](bool x) -> unsigned {{ return x; }};
    auto ones = [](unsigned x) -> int {{ return __builtin_popcount(x); }};
    auto exponential = [](float x) -> float {{ return wp::exp(x); }};
    auto over = [](float x, float y) -> float {{ return x / y; }};
    #endif

    // a warp has 8x4 pixels
    const int inside = thread % {BLOCK}, warp = inside / 32;
    const int tiles = canvas.tiles_across * canvas.tiles_down, view = tile / tiles;
    const int tile_x = (tile - view * tiles) % canvas.tiles_across * 16;
    const int tile_y = (tile - view * tiles) / canvas.tiles_across * 16;
    const int column = tile_x + warp % 2 * 8 + inside % 8, row = tile_y + warp / 2 * 4 + inside % 32 / 8;
    const float x = column + 0.5f, y = row + 0.5f;

    const int stride = canvas.tiles_across * 16;
    const long long plane = stride * 16ll * canvas.tiles_down;
    const int features = canvas.features, before = view * canvas.gaussians;
    const long long at = row * (long long)stride + column;
    float* const shown = image.data + view * (5ll + features) * plane + at;
    const float *const front = canvas.front.data + view * 5 * plane + at, *const back = canvas.back.data
        + view * 5 * plane + at;
    const bool has_front = canvas.has_front, has_back = canvas.has_back;
    auto feature_of = [&](int gaussian, int f) -> float {{
        return canvas.feature.data[(gaussian - before) * (long long)features + f];
    }};
    float T = has_front ? front[4 * plane] : column < canvas.width && row < canvas.height ? 1.0f : 0.0f;

    // x, y, conic | conic, opacity, colour | colour, depth; after the last of a batch comes nobody, who is transparent
    struct alignas(16) Row {{ float a, b, c, d; }};
    #if defined(__CUDA_ARCH__)
    __shared__ Row batches[2][{batch} + 1][3];
    __shared__ int isects[2][{batch}], gaussians[2][{batch} + 1], reached[2][{batch}];
    __shared__ unsigned lists[{WARPS}][({batch} + {AT_ONCE} + 3) / 4];
    unsigned char* const list = (unsigned char*)lists[warp];
    if (threadIdx.x < 2) {{
        for (int part = 0; part < 3; ++part) batches[threadIdx.x][{batch}][part] = Row{{}};
        gaussians[threadIdx.x][{batch}] = before;
    }}
    // one batch behind the other: which intersections, who that is, and their rows
    const int loaded = threadIdx.x / {loaders}, row_loaded = threadIdx.x % {loaders} * {rows};
    int later_isect = 0, next_isect = 0, next_gaussian = 0, next_reached = 0;
    int own_isect = 0, own_gaussian = 0, own_reached = 0, side = 0;
    Row own[{rows}] = {{}};
    auto has_one = [&](int begin) -> bool {{ return loaded < {batch} && begin >= first && begin + loaded < end; }};
    auto fetch = [&](int begin) -> void {{  // what is stored after this batch
        own_isect = next_isect, own_gaussian = next_gaussian, own_reached = next_reached;
        if (has_one(begin + {batch}))
            for (int i = 0; i < {rows}; ++i) own[i] = ((const Row*)(records.data + own_gaussian))[row_loaded + i];
        next_isect = later_isect;
        if (has_one(begin + 2 * {batch})) {{
            next_gaussian = bins.gaussian_from_isect.data[next_isect];
            next_reached = reached_from_isect.data[next_isect];
        }}
        if (has_one(begin + 3 * {batch})) later_isect = bins.isect_from_sorted.data[begin + 3 * {batch} + loaded];
    }};
    for (int ahead = 3; ahead > 0; --ahead) fetch(first - ahead * {batch});
    auto load = [&](int begin) -> bool {{  // whether anybody still sees it
        side = 1 - side;  // others may be reading that which came before
        if (loaded < {batch}) {{
            for (int i = 0; i < {rows}; ++i) batches[side][loaded][row_loaded + i] = own[i];
            isects[side][loaded] = own_isect, gaussians[side][loaded] = own_gaussian;
            reached[side][loaded] = own_reached;
        }}
        if (__syncthreads_and(T < {constants.STOP_TRANSMITTANCE}f)) return false;
        fetch(begin);
        return true;
    }};
    auto isect_of = [&](int k) -> int {{ return isects[side][k]; }};
    auto gaussian_of = [&](int k) -> int {{ return gaussians[side][k]; }};
    auto is_reached = [&](int k) -> bool {{ return reached[side][k] >> warp & 1; }};
    auto row_of = [&](int k, int part) -> Row {{ return batches[side][k][part]; }};
    #else
    int begun = first;
    alignas(4) unsigned char list[{batch} + {AT_ONCE}];
    auto load = [&](int begin) -> bool {{
        begun = begin;
        return true;  // who knows of the others? Every pixel is to keep its states
    }};
    auto isect_of = [&](int k) -> int {{ return bins.isect_from_sorted.data[begun + k]; }};
    auto gaussian_of = [&](int k) -> int {{
        return k < {batch} ? bins.gaussian_from_isect.data[isect_of(k)] : before;
    }};
    auto is_reached = [&](int k) -> bool {{ return reached_from_isect.data[isect_of(k)] >> warp & 1; }};
    auto row_of = [&](int k, int part) -> Row {{
        return k < {batch} ? ((const Row*)(records.data + gaussian_of(k)))[part] : Row{{}};
    }};
    #endif
    auto list_hits = [&](int count) -> int {{  // whom of the batch the warp draws, and nobody a few times
        int hits = 0;
        if (!ballot(T >= {constants.STOP_TRANSMITTANCE}f)) return hits;
        for (int some = 0; some < count; some += lanes) {{
            const bool is_hit = some + lane < count && is_reached(some + lane);
            const unsigned all = ballot(is_hit);
            if (is_hit) list[hits + ones(all & ((1u << lane) - 1u))] = some + lane;
            hits += ones(all);
        }}
        for (int k = lane; k < {AT_ONCE}; k += lanes) list[hits + k] = {batch};
        #if defined(__CUDA_ARCH__)
        __syncwarp();
        #endif
        return hits;
    }};
    auto power_of = [](const Row& p, const Row& q, float dx, float dy) -> float {{
        const float power = -0.5f * (p.c * dx * dx + q.a * dy * dy) - p.d * dx * dy;
        return power < 0.0f ? power : 0.0f;
    }};
    auto alpha_of = [&](const Row& p, const Row& q) -> float {{  // before it is clamped
        return q.b * exponential(power_of(p, q, x - p.a, y - p.b));
    }};
    auto is_kept = [&](float raw) -> bool {{
        return raw >= {constants.MIN_ALPHA}f && T >= {constants.STOP_TRANSMITTANCE}f;
    }};
    auto clamped = [](float raw) -> float {{ return raw < {constants.MAX_ALPHA}f ? raw : {constants.MAX_ALPHA}f; }};

    // what is kept of a pixel: transmittance, r, g, b, depth, features
    auto kept_of = [&](int segment, int k) -> float& {{
        return states.data[(segment * (5ll + features) + k) * {BLOCK} + inside];
    }};
    auto segment_of = [&](int k) -> int {{  // that begins with intersection k of the tile: each has its own
        return span[0] / {SEGMENT} + tile + (k - span[0]) / {SEGMENT};
    }};
"""


_COMPOSITE = f"""
    const int tile = tile_from_block.data[thread / {BLOCK}];
    const wp::vec_t<2, int> span = bins.ranges.data[tile];
    const int first = span[0], end = span[1];
{_prelude(SEGMENT)}
    float total[5] = {{}};
    if (has_front) for (int c = 0; c < 4; ++c) total[c] = front[c * plane];
    total[4] = 1.0f - T;
    #pragma unroll 1
    for (int f = 0; f < features; ++f) shown[(5 + f) * plane] = 0.0f;
    for (int begin = first; begin < end; begin += {SEGMENT}) {{
        if (!load(begin)) break;
        if (states.shape[0]) {{
            const int segment = segment_of(begin);
            if (inside == 0) tile_from_segment.data[segment] = tile;
            kept_of(segment, 0) = T;
            for (int c = 0; c < 4; ++c) kept_of(segment, 1 + c) = total[c];
            for (int f = 0; f < features; ++f) kept_of(segment, 5 + f) = shown[(5 + f) * plane];
        }}
        const int hits = list_hits(end - begin < {SEGMENT} ? end - begin : {SEGMENT});
        for (int hit = 0; hit < hits; hit += {AT_ONCE}) {{
            int k[{AT_ONCE}];
            float alpha[{AT_ONCE}], w[{AT_ONCE}];
            #pragma unroll
            for (int i = 0; i < {AT_ONCE}; ++i) {{
                k[i] = ((const unsigned*)(list + hit))[i / 4] >> i % 4 * 8 & 255;
                const float raw = alpha_of(row_of(k[i], 0), row_of(k[i], 1));
                alpha[i] = raw >= {constants.MIN_ALPHA}f ? clamped(raw) : 0.0f;
            }}
            #pragma unroll
            for (int i = 0; i < {AT_ONCE}; ++i) {{
                w[i] = T >= {constants.STOP_TRANSMITTANCE}f ? T * alpha[i] : 0.0f;
                T -= w[i];
                const Row q = row_of(k[i], 1), r = row_of(k[i], 2);
                total[0] += w[i] * q.c;
                total[1] += w[i] * q.d;
                total[2] += w[i] * r.a;
                total[3] += w[i] * r.b;
                total[4] += w[i];
            }}
            #pragma unroll 1
            for (int f = 0; f < features; ++f)
                #pragma unroll
                for (int i = 0; i < {AT_ONCE}; ++i)
                    shown[(5 + f) * plane] += w[i] * feature_of(gaussian_of(k[i]), f);
        }}
    }}
    for (int c = 0; c < 5; ++c) shown[c * plane] = total[c] + (has_back ? T * back[c * plane] : 0.0f);
"""

_ADJOINT = f"""
    const int segment = thread / {BLOCK}, tile = tile_from_segment.data[segment];
    if (tile < 0) return;
    const wp::vec_t<2, int> span = bins.ranges.data[tile];
    const int first = span[0] + (segment - span[0] / {SEGMENT} - tile) * {SEGMENT};
    const int end = span[1] - first < {SEGMENT} ? span[1] : first + {SEGMENT};
{_prelude(BATCH)}
    #if defined(__CUDA_ARCH__)
    __shared__ float parts[{WARPS}][{BATCH}][10];
    __shared__ unsigned long long said[{WARPS}];
    // the sums by halves end in every other lane: which number this one has
    const int fifth = (lane >> 3 & 1) * 3 + (lane >> 2 & 1) * 2 + (lane >> 1 & 1);
    const bool has_number = lane % 2 == 0 && (lane & 8 ? fifth < 5 : fifth < 3);
    const int number = (lane >> 4) * 5 + fifth;
    auto halve = [&](const float* from, int count, float* to, int kept, int other) -> void {{
        const bool upper = lane & other;
        #pragma unroll
        for (int k = 0; k < kept; ++k) {{
            const float above = kept + k < count ? from[kept + k] : 0.0f;
            to[k] = (upper ? above : from[k]) + __shfl_xor_sync(~0u, upper ? from[k] : above, other);
        }}
    }};
    #endif
    auto v_of = [&](const auto& v, int channel) -> float {{
        if (row >= v.shape[2] || column >= v.shape[3]) return 0.0f;
        return *(const float*)((const char*)v.data + view * (long long)v.strides[0]
            + channel * (long long)v.strides[1] + row * (long long)v.strides[2] + column * (long long)v.strides[3]);
    }};
    float v[5], rest = 0.0f;
    for (int c = 0; c < 3; ++c) v[c] = v_of(v_image.rgb, c);
    v[3] = v_of(v_image.depth, 0);
    v[4] = v_of(v_image.alpha, 0);
    T = kept_of(segment, 0);
    for (int c = 0; c < 5; ++c) rest += v[c] * (shown[c * plane] - (c < 4 ? kept_of(segment, 1 + c) : 1.0f - T));
    #pragma unroll 1
    for (int f = 0; f < features; ++f)
        rest += v_of(v_image.features, f) * (shown[(5 + f) * plane] - kept_of(segment, 5 + f));

    for (int begin = first; begin < end; begin += {BATCH}) {{
        if (!load(begin)) break;
        const int count = end - begin < {BATCH} ? end - begin : {BATCH}, hits = list_hits(count);
        unsigned long long spoke = 0;
        for (int hit = 0; hit < hits; ++hit) {{
            const int k = list[hit];
            const Row p = row_of(k, 0), q = row_of(k, 1), r = row_of(k, 2);
            const float raw = alpha_of(p, q), alpha = clamped(raw), w = is_kept(raw) ? T * alpha : 0.0f;
            if (!ballot(w > 0.0f)) continue;
            float gain = v[0] * q.c + v[1] * q.d + v[2] * r.a + v[3] * r.b + v[4];
            #pragma unroll 1
            for (int f = 0; f < features; ++f)
                gain += v_of(v_image.features, f) * feature_of(gaussian_of(k), f);
            rest -= w * gain;
            T -= w;
            if (gaussian_of(k) - before >= trainable) continue;
            // the clamp passes no gradient
            const bool is_free = w > 0.0f && raw < {constants.MAX_ALPHA}f;
            const float v_power = is_free ? w * gain - over(rest * alpha, 1.0f - alpha) : 0.0f;
            const float dx = x - p.a, dy = y - p.b, v_x = v_power * dx, v_y = v_power * dy;
            const float moments[10] = {{
                v_power, v_x, v_y, v_x * dx, v_x * dy, v_y * dy, w * v[0], w * v[1], w * v[2], w * v[3],
            }};
            #if defined(__CUDA_ARCH__)
            float fives[5], threes[3], twos[2], ones[1], sum[1];
            halve(moments, 10, fives, 5, 16);
            halve(fives, 5, threes, 3, 8);
            halve(threes, 3, twos, 2, 4);
            halve(twos, 2, ones, 1, 2);
            halve(ones, 1, sum, 1, 1);
            if (has_number) parts[warp][k][number] = sum[0];
            spoke |= 1ull << k;
            #else
            for (int j = 0; j < 10; ++j) slots.data[isect_of(k) * {BLOCK}ll + inside][j] = moments[j];
            #endif
            #pragma unroll 1
            for (int f = 0; f < features; ++f) {{
                float v_feature = w * v_of(v_image.features, f);
                #if defined(__CUDA_ARCH__)
                for (int other = 16; other > 0; other /= 2) v_feature += __shfl_xor_sync(~0u, v_feature, other);
                if (lane == 0) feature_slots.data[(isect_of(k) * {WARPS}ll + warp) * features + f] = v_feature;
                #else
                feature_slots.data[(isect_of(k) * {BLOCK}ll + inside) * features + f] = v_feature;
                #endif
            }}
        }}
        #if defined(__CUDA_ARCH__)
        if (lane == 0) said[warp] = spoke;
        __syncthreads();
        for (int i = threadIdx.x; i < count * 10; i += {BLOCK}) {{
            const int k = i / 10;
            float sum = 0.0f;
            bool is_touched = false;
            #pragma unroll
            for (int other = 0; other < {WARPS}; ++other)
                if (said[other] >> k & 1) is_touched = true, sum += parts[other][k][i % 10];
            if (is_touched) slots.data[isect_of(k)][i % 10] = sum;
        }}
        #endif
    }}
"""


@wp.func_native(_COMPOSITE)
def draw_pixel(
    thread: int,
    canvas: Canvas,
    bins: Bins,
    reached_from_isect: wp.array(dtype=int),
    tile_from_block: wp.array(dtype=int),
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    states: wp.array(dtype=float),
    tile_from_segment: wp.array(dtype=int),
):
    """Draw the pixel of a thread, and keep its state where there is room for it."""


@wp.func_native(_ADJOINT)
def draw_pixel_adjoint(
    thread: int,
    canvas: Canvas,
    bins: Bins,
    reached_from_isect: wp.array(dtype=int),
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    states: wp.array(dtype=float),
    tile_from_segment: wp.array(dtype=int),
    v_image: Gradient,
    trainable: int,
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
):
    """Add what the pixel of a thread says to slots, which start as zeros and take moments, see `gather`."""


@wp.kernel
def composite(
    canvas: Canvas,
    bins: Bins,
    reached_from_isect: wp.array(dtype=int),
    tile_from_block: wp.array(dtype=int),
    records: wp.array(dtype=record16),
    # outputs
    image: wp.array(dtype=float),
    states: wp.array(dtype=float),
    tile_from_segment: wp.array(dtype=int),
):
    """Draw one pixel per thread; where there is room, keep for the adjoint what it needs of every segment.

    Segments that are not reached are those of no tile: ``tile_from_segment`` starts as -1.
    """
    draw_pixel(wp.tid(), canvas, bins, reached_from_isect, tile_from_block, records, image, states, tile_from_segment)


@wp.kernel
def composite_adjoint(
    canvas: Canvas,
    bins: Bins,
    reached_from_isect: wp.array(dtype=int),
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    states: wp.array(dtype=float),
    tile_from_segment: wp.array(dtype=int),
    v_image: Gradient,
    trainable: int,
    # outputs
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
):
    """One pixel of a segment per thread; `PARTS` slots per intersection and `FEATURE_PARTS` of features, once zeros."""
    draw_pixel_adjoint(
        wp.tid(),
        canvas,
        bins,
        reached_from_isect,
        records,
        image,
        states,
        tile_from_segment,
        v_image,
        trainable,
        slots,
        feature_slots,
    )
