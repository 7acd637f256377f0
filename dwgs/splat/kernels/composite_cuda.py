# type: ignore  (Warp's language, which is not Python's)
"""The two compositing loops on a GPU: one block per 16x16 tile, one warp per 8x4 pixels of it, one thread per pixel.

A block carries the Gaussians of its tile into shared memory, batch by batch, the next on its way while one is drawn.
Each lane asks of one Gaussian whether it reaches the warp's pixels, and the warp draws those that do. In the adjoint
a warp sums its pixels' gradients by halves, so that twelve shuffles do for ten numbers, and the block sums those of
its warps in order: no atomics, and the same bytes every time.

The same text runs on a CPU, every pixel being a block, a warp and a lane by itself: slow, but a witness for
everything but the exchange between threads. Launched over tiles x `BLOCK` threads, ``block_dim=BLOCK``.
"""

from math import log

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
"""Gaussians in shared memory at once: three threads load each, and 32 lanes at a time ask for them."""
AT_ONCE = 4
"""Gaussians a warp draws at once, so that one need not wait for the numbers of the other."""
SLACK = 0.01
"""On the logarithm of alpha: no rounding hides a Gaussian from the pixels it reaches."""

_PRELUDE = f"""
    #if defined(__CUDA_ARCH__)
    const int lanes = 32, lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    auto ballot = [](bool x) -> unsigned {{ return __ballot_sync(~0u, x); }};
    auto exponential = [](float x) -> float {{ return __expf(x); }};
    auto logarithm = [](float x) -> float {{ return __logf(x); }};
    auto over = [](float x, float y) -> float {{ return __fdividef(x, y); }};
    #else
    const int lanes = 1, lane = 0;
    auto ballot = [](bool x) -> unsigned {{ return x; }};
    auto exponential = [](float x) -> float {{ return wp::exp(x); }};
    auto logarithm = [](float x) -> float {{ return wp::log(x); }};
    auto over = [](float x, float y) -> float {{ return x / y; }};
    #endif

    // a warp has 8x4 pixels
    const int tile = thread / {BLOCK}, inside = thread % {BLOCK};
    const int tiles = canvas.tiles_across * canvas.tiles_down, view = tile / tiles;
    const int left = (tile - view * tiles) % canvas.tiles_across * 16 + inside / 32 % 2 * 8;
    const int top = (tile - view * tiles) / canvas.tiles_across * 16 + inside / 64 * 4;
    const int column = left + inside % 8, row = top + inside % 32 / 8;
    const float x = column + 0.5f, y = row + 0.5f;
    const float left_x = lanes > 1 ? left + 0.5f : x, right_x = lanes > 1 ? left + 7.5f : x;
    const float top_y = lanes > 1 ? top + 0.5f : y, bottom_y = lanes > 1 ? top + 3.5f : y;

    const int stride = canvas.tiles_across * 16;
    const long long plane = stride * 16ll * canvas.tiles_down;
    const int features = canvas.features, before = view * canvas.gaussians;
    const long long at = row * (long long)stride + column;
    float* const shown = image.data + view * (5ll + features) * plane + at;
    const float *const front = canvas.front.data + view * 5 * plane + at, *const back = canvas.back.data
        + view * 5 * plane + at;
    const bool layered = canvas.layered;
    auto feature_of = [&](int gaussian, int f) -> float {{
        return canvas.feature.data[(gaussian - before) * (long long)features + f];
    }};
    float T = layered ? front[4 * plane] : column < canvas.width && row < canvas.height ? 1.0f : 0.0f;

    // x, y, conic | conic, opacity, colour | colour, depth
    struct alignas(16) Row {{ float a, b, c, d; }};
    const wp::vec_t<2, int> span = bins.ranges.data[tile];
    const int first = span[0], end = span[1];
    #if defined(__CUDA_ARCH__)
    __shared__ Row batch[{BATCH}][3];
    __shared__ int isects[{BATCH}], gaussians[{BATCH}];
    const int loaded = threadIdx.x / 3, third = threadIdx.x % 3;
    int next_isect = 0, next_gaussian = 0, own_isect = 0, own_gaussian = 0;
    Row own = {{}};
    auto ask = [&](int begin) -> void {{  // for whom to load
        if (loaded >= {BATCH} || begin + loaded >= end) return;
        next_isect = bins.isect_from_sorted.data[begin + loaded];
        next_gaussian = bins.gaussian_from_isect.data[next_isect];
    }};
    auto fetch = [&](int begin) -> void {{
        own_isect = next_isect, own_gaussian = next_gaussian;
        if (loaded < {BATCH} && begin + loaded < end) own = ((const Row*)(records.data + own_gaussian))[third];
    }};
    ask(first);
    fetch(first);
    ask(first + {BATCH});
    auto load = [&](int begin) -> void {{
        __syncthreads();  // nobody reads the last batch any more
        if (loaded < {BATCH}) batch[loaded][third] = own;
        if (loaded < {BATCH} && third == 0) isects[loaded] = own_isect, gaussians[loaded] = own_gaussian;
        __syncthreads();
        fetch(begin + {BATCH});
        ask(begin + 2 * {BATCH});
    }};
    auto all_threads = [](bool x) -> bool {{ return __syncthreads_and(x); }};
    auto isect_of = [&](int k) -> int {{ return isects[k]; }};
    auto gaussian_of = [&](int k) -> int {{ return gaussians[k]; }};
    auto row_of = [&](int k, int part) -> Row {{ return batch[k][part]; }};
    #else
    int begun = first;
    auto load = [&](int begin) -> void {{ begun = begin; }};
    auto all_threads = [](bool x) -> bool {{ return x; }};
    auto isect_of = [&](int k) -> int {{ return bins.isect_from_sorted.data[begun + k]; }};
    auto gaussian_of = [&](int k) -> int {{ return bins.gaussian_from_isect.data[isect_of(k)]; }};
    auto row_of = [&](int k, int part) -> Row {{ return ((const Row*)(records.data + gaussian_of(k)))[part]; }};
    #endif
    auto clamp = [](float t, float low, float high) -> float {{ return t < low ? low : t > high ? high : t; }};
    auto power_of = [](const Row& p, const Row& q, float dx, float dy) -> float {{
        const float power = -0.5f * (p.c * dx * dx + q.a * dy * dy) - p.d * dx * dy;
        return power < 0.0f ? power : 0.0f;
    }};
    auto reaches = [&](int k) -> bool {{  // strongest, it is on one of the two nearest edges of the warp's pixels
        const Row p = row_of(k, 0), q = row_of(k, 1);
        const float near_x = clamp(p.a, left_x, right_x) - p.a, near_y = clamp(p.b, top_y, bottom_y) - p.b;
        const float along_y = clamp(-over(p.d * near_x, q.a), top_y - p.b, bottom_y - p.b);
        const float along_x = clamp(-over(p.d * near_y, p.c), left_x - p.a, right_x - p.a);
        const float by_x = power_of(p, q, near_x, along_y), by_y = power_of(p, q, along_x, near_y);
        return (by_x > by_y ? by_x : by_y) + logarithm(q.b) > {log(constants.MIN_ALPHA) - SLACK}f;
    }};
    auto next = [](unsigned& hits) -> int {{  // of these bits the lowest, which is cleared
        #if defined(__CUDA_ARCH__)
        const int k = __ffs(hits) - 1;
        #else
        const int k = __builtin_ctz(hits);
        #endif
        hits &= hits - 1;
        return k;
    }};
    auto draw_next = [&](unsigned& hits, int some, int* k, float* raw) -> int {{  // alphas of so many; of the rest 0
        int drawn = 0;
        #pragma unroll
        for (int i = 0; i < {AT_ONCE}; ++i) {{
            const bool is_one = hits;
            drawn += is_one;
            k[i] = is_one ? some + next(hits) : some;
            const Row p = row_of(k[i], 0), q = row_of(k[i], 1);
            raw[i] = is_one ? q.b * exponential(power_of(p, q, x - p.a, y - p.b)) : 0.0f;
        }}
        return drawn;
    }};
    auto is_kept = [&](float raw) -> bool {{
        return raw >= {constants.MIN_ALPHA}f && T >= {constants.STOP_TRANSMITTANCE}f;
    }};
    auto clamped = [](float raw) -> float {{ return raw < {constants.MAX_ALPHA}f ? raw : {constants.MAX_ALPHA}f; }};
"""


_COMPOSITE = f"""
{_PRELUDE}
    float total[5] = {{}};
    if (layered) for (int c = 0; c < 4; ++c) total[c] = front[c * plane];
    total[4] = 1.0f - T;
    #pragma unroll 1
    for (int f = 0; f < features; ++f) shown[(5 + f) * plane] = 0.0f;
    for (int begin = first; begin < end; begin += {BATCH}) {{
        if (all_threads(T < {constants.STOP_TRANSMITTANCE}f)) break;
        load(begin);
        const int count = end - begin < {BATCH} ? end - begin : {BATCH};
        for (int some = 0; some < count; some += lanes) {{
            if (!ballot(T >= {constants.STOP_TRANSMITTANCE}f)) break;
            unsigned hits = ballot(some + lane < count && reaches(some + lane));
            while (hits) {{
                int k[{AT_ONCE}];
                float raw[{AT_ONCE}], w[{AT_ONCE}];
                draw_next(hits, some, k, raw);
                #pragma unroll
                for (int i = 0; i < {AT_ONCE}; ++i) {{
                    w[i] = is_kept(raw[i]) ? T * clamped(raw[i]) : 0.0f;
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
                    for (int i = 0; i < {AT_ONCE}; ++i)
                        shown[(5 + f) * plane] += w[i] * feature_of(gaussian_of(k[i]), f);
            }}
        }}
    }}
    for (int c = 0; c < 5; ++c) shown[c * plane] = total[c] + (layered ? T * back[c * plane] : 0.0f);
"""

_ADJOINT = f"""
{_PRELUDE}
    #if defined(__CUDA_ARCH__)
    __shared__ float parts[{WARPS}][{BATCH}][10];
    __shared__ unsigned said[{WARPS}][{BATCH} / 32];
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
    for (int c = 0; c < 5; ++c)
        rest += v[c] * (shown[c * plane] - (!layered ? 0.0f : c < 4 ? front[c * plane] : 1.0f - T));
    #pragma unroll 1
    for (int f = 0; f < features; ++f) rest += v_of(v_image.features, f) * shown[(5 + f) * plane];

    for (int begin = first; begin < end; begin += {BATCH}) {{
        if (all_threads(T < {constants.STOP_TRANSMITTANCE}f)) break;
        load(begin);
        const int count = end - begin < {BATCH} ? end - begin : {BATCH};
        for (int some = 0; some < count; some += lanes) {{
            unsigned hits = ballot(some + lane < count && reaches(some + lane));
            if (!ballot(T >= {constants.STOP_TRANSMITTANCE}f)) hits = 0;
            unsigned spoke = 0;
            while (hits) {{
                int k[{AT_ONCE}];
                float raw[{AT_ONCE}], gain[{AT_ONCE}], w[{AT_ONCE}], v_power[{AT_ONCE}];
                const int drawn = draw_next(hits, some, k, raw);
                #pragma unroll
                for (int i = 0; i < {AT_ONCE}; ++i) {{
                    const Row q = row_of(k[i], 1), r = row_of(k[i], 2);
                    gain[i] = v[0] * q.c + v[1] * q.d + v[2] * r.a + v[3] * r.b + v[4];
                }}
                #pragma unroll 1
                for (int f = 0; f < features; ++f)
                    for (int i = 0; i < {AT_ONCE}; ++i)
                        gain[i] += v_of(v_image.features, f) * feature_of(gaussian_of(k[i]), f);
                #pragma unroll
                for (int i = 0; i < {AT_ONCE}; ++i) {{
                    const float alpha = clamped(raw[i]);
                    const bool is_free = is_kept(raw[i]) && raw[i] < {constants.MAX_ALPHA}f;  // else no gradient
                    w[i] = is_kept(raw[i]) ? T * alpha : 0.0f;
                    rest -= w[i] * gain[i];
                    T -= w[i];
                    v_power[i] = is_free ? w[i] * gain[i] - over(rest * alpha, 1.0f - alpha) : 0.0f;
                }}
                #pragma unroll
                for (int i = 0; i < {AT_ONCE}; ++i) {{
                    const Row p = row_of(k[i], 0);
                    const float dx = x - p.a, dy = y - p.b, v_x = v_power[i] * dx, v_y = v_power[i] * dy;
                    const float moments[10] = {{
                        v_power[i], v_x, v_y, v_x * dx, v_x * dy, v_y * dy, w[i] * v[0], w[i] * v[1], w[i] * v[2],
                        w[i] * v[3],
                    }};
                    const bool is_taught = i < drawn && gaussian_of(k[i]) - before < trainable;
                    #if defined(__CUDA_ARCH__)
                    float fives[5], threes[3], twos[2], ones[1], sum[1];
                    halve(moments, 10, fives, 5, 16);
                    halve(fives, 5, threes, 3, 8);
                    halve(threes, 3, twos, 2, 4);
                    halve(twos, 2, ones, 1, 2);
                    halve(ones, 1, sum, 1, 1);
                    if (has_number && is_taught) parts[warp][k[i]][number] = sum[0];
                    if (is_taught) spoke |= 1u << k[i] % 32;
                    #else
                    if (is_taught)
                        for (int j = 0; j < 10; ++j) slots.data[isect_of(k[i]) * {BLOCK}ll + inside][j] = moments[j];
                    #endif
                }}
                #pragma unroll 1
                for (int f = 0; f < features; ++f)
                    for (int i = 0; i < {AT_ONCE}; ++i) {{
                        if (i >= drawn) break;
                        float v_feature = w[i] * v_of(v_image.features, f);
                        #if defined(__CUDA_ARCH__)
                        for (int other = 16; other > 0; other /= 2)
                            v_feature += __shfl_xor_sync(~0u, v_feature, other);
                        if (lane == 0)
                            feature_slots.data[(isect_of(k[i]) * {WARPS}ll + warp) * features + f] = v_feature;
                        #else
                        feature_slots.data[(isect_of(k[i]) * {BLOCK}ll + inside) * features + f] = v_feature;
                        #endif
                    }}
            }}
            #if defined(__CUDA_ARCH__)
            if (lane == 0) said[warp][some / 32] = spoke;
            #endif
        }}
        #if defined(__CUDA_ARCH__)
        __syncthreads();
        for (int i = threadIdx.x; i < count * 10; i += {BLOCK}) {{
            const int k = i / 10;
            float sum = 0.0f;
            bool is_touched = false;
            #pragma unroll
            for (int other = 0; other < {WARPS}; ++other)
                if (said[other][k / 32] >> k % 32 & 1) is_touched = true, sum += parts[other][k][i % 10];
            if (is_touched) slots.data[isect_of(k)][i % 10] = sum;
        }}
        #endif
    }}
"""


@wp.func_native(_COMPOSITE)
def draw_pixel(
    thread: int, canvas: Canvas, bins: Bins, records: wp.array(dtype=record16), image: wp.array(dtype=float)
):
    """Draw the pixel of a thread."""


@wp.func_native(_ADJOINT)
def draw_pixel_adjoint(
    thread: int,
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    v_image: Gradient,
    trainable: int,
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
):
    """Add what the pixel of a thread says to slots, which start as zeros and take moments, see `gather`."""


@wp.kernel(launch_bounds=(BLOCK, 3))
def composite(
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    # outputs
    image: wp.array(dtype=float),
):
    """Draw one pixel per thread."""
    draw_pixel(wp.tid(), canvas, bins, records, image)


@wp.kernel(launch_bounds=(BLOCK, 2))
def composite_adjoint(
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
    """`PARTS` slots per intersection and `FEATURE_PARTS` of features; slots start as zeros."""
    draw_pixel_adjoint(wp.tid(), canvas, bins, records, image, v_image, trainable, slots, feature_slots)
