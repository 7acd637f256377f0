# type: ignore  (Warp's language, which is not Python's)
"""Loss on colour and its gradient on a GPU, one pass over the pixels, one block per row of them.

Images are [3, H, W] planes whose rows are dense; weights [H, W] are dense.
"""

import warp as wp

from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})

BLOCK = 256
"""Threads per row."""


@wp.func_native(f"""
    const int height = weights.shape[0], width = weights.shape[1];
    auto row_of = [&](const auto& image, int channel) -> const float* {{
        return (const float*)((const char*)image.data + channel * (long long)image.strides[0]
                              + row * (long long)image.strides[1]);
    }};
    float total = 0.0f, total_weight = 0.0f;
    for (int i = thread; i < width; i += {BLOCK}) {{
        const float weight = weights.data[row * (long long)width + i];
        total_weight += weight;
        for (int channel = 0; channel < 3; ++channel) {{
            const float d = row_of(rgb, channel)[i] - row_of(target, channel)[i];
            const float sign = d < 0.0f ? -1.0f : d > 0.0f ? 1.0f : 0.0f;
            total += weight * (squared ? d * d : sign * d);
            v_rgb.data[(channel * height + row) * (long long)width + i] = weight * (squared ? 2.0f * d : sign);
        }}
    }}
    #if defined(__CUDA_ARCH__)
    __shared__ float totals[2][{BLOCK} / 32];
    for (int other = 16; other > 0; other /= 2) {{
        total += __shfl_xor_sync(~0u, total, other);
        total_weight += __shfl_xor_sync(~0u, total_weight, other);
    }}
    if (thread % 32 == 0) totals[0][thread / 32] = total, totals[1][thread / 32] = total_weight;
    __syncthreads();
    if (thread == 0) {{
        total = total_weight = 0.0f;
        for (int warp = 0; warp < {BLOCK} / 32; ++warp) total += totals[0][warp], total_weight += totals[1][warp];
        sums.data[row] = wp::vec2(total, total_weight);
    }}
    #endif
""")
def row_error(
    row: int,
    thread: int,
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    squared: int,
    v_rgb: wp.array3d(dtype=float),
    sums: wp.array(dtype=wp.vec2),
):
    """Weighted error of a row of pixels, the sum of its weights, and the gradient."""


@wp.kernel
def error(
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    squared: int,
    # outputs
    v_rgb: wp.array3d(dtype=float),
    sums: wp.array(dtype=wp.vec2),
):
    """Weighted absolute or squared error by row of pixels, the sum of weights beside it, and the gradient."""
    row_error(wp.tid() / wp.static(BLOCK), wp.tid() % wp.static(BLOCK), rgb, target, weights, squared, v_rgb, sums)


@wp.func_native(f"""
    wp::vec2 total(0.0f, 0.0f);
    for (int row = thread; row < sums.shape[0]; row += {BLOCK}) total += sums.data[row];
    #if defined(__CUDA_ARCH__)
    __shared__ wp::vec2 totals[{BLOCK}];
    totals[thread] = total;
    for (int half = {BLOCK} / 2; half > 0; half /= 2) {{
        __syncthreads();
        if (thread < half) totals[thread] += totals[thread + half];
    }}
    total = totals[0];
    #endif
    if (thread) return;
    const float share = 1.0f / (3.0f * (total[1] > 1.0f ? total[1] : 1.0f));
    loss.data[0] = total[0] * share;
    loss.data[1] = share;
""")
def all_rows(thread: int, sums: wp.array(dtype=wp.vec2), loss: wp.array(dtype=float)):
    """Mean error, and what a pixel's weight is of all."""


@wp.kernel
def mean(sums: wp.array(dtype=wp.vec2), loss: wp.array(dtype=float)):
    """Of the sums of rows, by one block: the mean error by weight and channel, and what it was divided by, inverted."""
    all_rows(wp.tid(), sums, loss)
