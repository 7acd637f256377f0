# type: ignore  (Warp's language, which is not Python's)
"""Losses on colour and their gradients on a CPU, one pass over the pixels each.

Images are [3, H, W] planes whose rows are dense; weights [H, W] are dense.
"""

import warp as wp

from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})

BLOCK = 4
"""Pixels; two blocks make a window."""
MOMENTS = 5
"""x, y, x x, y y, x y."""

_ROWS = """
    const int height = weights.shape[0], width = weights.shape[1];
    auto row_of = [](const auto& image, int channel, int row) -> const float* {
        return (const float*)((const char*)image.data + channel * (long long)image.strides[0]
                              + row * (long long)image.strides[1]);
    };
"""

_ERROR = f"""
    #pragma clang fp reassociate(on)
{_ROWS}
    const float* const weight = weights.data + row * (long long)width;
    float total = 0.0f, total_weight = 0.0f;
    for (int i = 0; i < width; ++i) total_weight += weight[i];
    for (int channel = 0; channel < 3; ++channel) {{
        const float *const x = row_of(rgb, channel, row), *const y = row_of(target, channel, row);
        float* const v = v_rgb.data + (channel * height + row) * (long long)width;
        for (int i = 0; i < width; ++i) {{
            const float d = x[i] - y[i], size = d < 0.0f ? -d : d;
            const float sign = d < 0.0f ? -1.0f : d > 0.0f ? 1.0f : 0.0f;
            total += weight[i] * (squared ? d * d : size);
            v[i] = weight[i] * (squared ? 2.0f * d : sign);
        }}
    }}
    return wp::vec2(total, total_weight);
"""

_MOMENTS = f"""
{_ROWS}
    const int top = row * {BLOCK}, rows = height - top < {BLOCK} ? height - top : {BLOCK};
    float* const sums = (float*)__builtin_alloca({MOMENTS} * width * sizeof(float));  // down each column of pixels
    for (int channel = 0; channel < 3; ++channel) {{
        for (int i = 0; i < {MOMENTS} * width; ++i) sums[i] = 0.0f;
        for (int r = top; r < top + rows; ++r) {{
            const float *const xs = row_of(rgb, channel, r), *const ys = row_of(target, channel, r);
            const float* const weight = weights.data + r * (long long)width;
            for (int i = 0; i < width; ++i) {{
                const float y = ys[i], x = weight[i] > 0.0f ? xs[i] : y;
                sums[i] += x;
                sums[width + i] += y;
                sums[2 * width + i] += x * x;
                sums[3 * width + i] += y * y;
                sums[4 * width + i] += x * y;
            }}
        }}
        for (int m = 0; m < {MOMENTS}; ++m) {{
            const int blocks = moments.shape[2];
            float* const out = moments.data + ((m * 3 + channel) * moments.shape[1] + row) * (long long)blocks;
            for (int b = 0; b < blocks; ++b) {{
                const int left = b * {BLOCK}, right = left + {BLOCK} < width ? left + {BLOCK} : width;
                float total = 0.0f;
                for (int i = left; i < right; ++i) total += sums[m * width + i];
                out[b] = total / (rows * (right - left));
            }}
        }}
    }}
"""

_MOMENTS_ADJOINT = f"""
{_ROWS}
    const int top = row * {BLOCK}, rows = height - top < {BLOCK} ? height - top : {BLOCK};
    float* const v = (float*)__builtin_alloca(3 * width * sizeof(float));  // by x, x x, x y along a row of pixels
    for (int channel = 0; channel < 3; ++channel) {{
        for (int m = 0; m < 3; ++m) {{
            const int moment = m < 2 ? 2 * m : 4;
            const float* const v_block = v_moments.data
                + ((moment * 3 + channel) * v_moments.shape[1] + row) * (long long)v_moments.shape[2];
            for (int b = 0; b < v_moments.shape[2]; ++b) {{
                const int left = b * {BLOCK}, right = left + {BLOCK} < width ? left + {BLOCK} : width;
                for (int i = left; i < right; ++i) v[m * width + i] = v_block[b] / (rows * (right - left));
            }}
        }}
        for (int r = top; r < top + rows; ++r) {{
            const float *const xs = row_of(rgb, channel, r), *const ys = row_of(target, channel, r);
            const float* const weight = weights.data + r * (long long)width;
            float* const v_x = v_rgb.data + (channel * height + r) * (long long)width;
            for (int i = 0; i < width; ++i) {{
                const float value = v[i] + 2.0f * xs[i] * v[width + i] + ys[i] * v[2 * width + i];
                v_x[i] = weight[i] > 0.0f ? value : 0.0f;
            }}
        }}
    }}
"""


@wp.func_native(_ERROR)
def row_error(
    row: int,
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    squared: int,
    v_rgb: wp.array3d(dtype=float),
) -> wp.vec2:
    """Weighted error of a row of pixels and the sum of its weights."""


@wp.func_native(_MOMENTS)
def block_moments(
    row: int,
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    moments: wp.array3d(dtype=float),
):
    """Means over a row of blocks."""


@wp.func_native(_MOMENTS_ADJOINT)
def block_moments_adjoint(
    row: int,
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    v_moments: wp.array3d(dtype=float),
    v_rgb: wp.array3d(dtype=float),
):
    """Gradient by a row of blocks."""


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
    row = wp.tid()
    sums[row] = row_error(row, rgb, target, weights, squared, v_rgb)


@wp.kernel
def moments(
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    # outputs
    out: wp.array3d(dtype=float),
):
    """Means of x, y, x x, y y, x y over blocks of pixels; where there is no weight, x is y."""
    block_moments(wp.tid(), rgb, target, weights, out)


@wp.kernel
def moments_adjoint(
    rgb: wp.array3d(dtype=float),
    target: wp.array3d(dtype=float),
    weights: wp.array2d(dtype=float),
    v_moments: wp.array3d(dtype=float),
    # outputs
    v_rgb: wp.array3d(dtype=float),
):
    """The gradient by x."""
    block_moments_adjoint(wp.tid(), rgb, target, weights, v_moments, v_rgb)
