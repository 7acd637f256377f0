# type: ignore  (Warp's language, which is not Python's)
"""Adam (Kingma and Ba 2015) in one pass over memory, on a CPU: sixteen numbers per instruction."""

import warp as wp

from dwgs.optimize.kernels.activation import Activation, activate_means, activate_opacities, activate_scales
from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})

SPAN = 1024
"""Gaussians per task."""
LANES = 16
"""Numbers per instruction."""


@wp.struct
class Group:
    """Parameters that share a derivative and a pattern of rates.

    Patterns repeat with ``period`` and go on for `LANES` more: [period + LANES] each.
    """

    raw: wp.array(dtype=float)
    moment: wp.array(dtype=float)
    """Running mean of the gradient."""
    variance: wp.array(dtype=float)
    """Running mean of its square."""
    derivative: wp.array(dtype=float)
    """Of the activated by the raw parameter; empty: 1."""
    gradient: wp.array(dtype=float)
    """By the activated parameter; empty: nothing moves."""
    rates: wp.array(dtype=float)
    stills: wp.array(dtype=float)
    """Below this a gradient moves its parameter in proportion only: Adam's epsilon."""
    is_rest: wp.array(dtype=float)
    """0 or 1: the variance of which class is summed."""
    period: int


@wp.func_native("""
    typedef float block __attribute__((vector_size(64)));
    typedef float loose __attribute__((vector_size(64), aligned(4)));
    if (group.gradient.shape[0] == 0) return wp::vec2(0.0f, 0.0f);
    const bool derived = group.derivative.shape[0] > 0;
    auto advance = [&](auto g, auto d, auto& raw, auto& m, auto& v, auto rate, auto still, auto root) {
        g *= d;
        m = beta1 * m + (1.0f - beta1) * g;
        v = beta2 * v + (1.0f - beta2) * g * g;
        raw -= rate * step1 * m / (root(v) * step2 + still);
    };
    block all = {}, rest = {};
    int i = begin;
    for (; i + 16 <= end; i += 16) {
        auto load = [](const float* at) -> block { return *(const loose*)at; };
        const int p = i % group.period;
        block raw = load(group.raw.data + i), m = load(group.moment.data + i), v = load(group.variance.data + i);
        const block d = derived ? load(group.derivative.data + i) : block{} + 1.0f;
        advance(load(group.gradient.data + i), d, raw, m, v, load(group.rates.data + p), load(group.stills.data + p),
                [](block x) -> block { return __builtin_elementwise_sqrt(x); });
        *(loose*)(group.raw.data + i) = raw;
        *(loose*)(group.moment.data + i) = m;
        *(loose*)(group.variance.data + i) = v;
        all += v;
        rest += v * load(group.is_rest.data + p);
    }
    float total = 0.0f, total_rest = 0.0f;
    for (int lane = 0; lane < 16; ++lane) total += all[lane], total_rest += rest[lane];
    for (; i < end; ++i) {
        const int p = i % group.period;
        float raw = group.raw.data[i], m = group.moment.data[i], v = group.variance.data[i];
        advance(group.gradient.data[i], derived ? group.derivative.data[i] : 1.0f, raw, m, v, group.rates.data[p],
                group.stills.data[p], [](float x) -> float { return __builtin_sqrtf(x); });
        group.raw.data[i] = raw;
        group.moment.data[i] = m;
        group.variance.data[i] = v;
        total += v;
        total_rest += v * group.is_rest.data[p];
    }
    return wp::vec2(total - total_rest, total_rest);
""")
def adam_span(begin: int, end: int, group: Group, beta1: float, beta2: float, step1: float, step2: float) -> wp.vec2:
    """One step for the parameters [begin, end); the sums of both classes' new variances."""


@wp.kernel
def adam(
    first: int,
    means: Group,
    quats: Group,
    scales: Group,
    opacities: Group,
    sh: Group,
    beta1: float,
    beta2: float,
    step1: float,
    step2: float,
    # outputs
    to: Activation,
    sums: wp.array2d(dtype=wp.vec2),
):
    """One step, `SPAN` Gaussians a task, and the Gaussians it leads to.

    ``step1``, ``step2`` undo the moments' start at zero. ``sums`` are by task and group those of the new variances.
    """
    task = first + wp.tid()
    begin = task * SPAN
    end = wp.min(begin + SPAN, opacities.raw.shape[0])
    width = sh.period
    sums[task, 0] = adam_span(3 * begin, 3 * end, means, beta1, beta2, step1, step2)
    sums[task, 1] = adam_span(4 * begin, 4 * end, quats, beta1, beta2, step1, step2)
    sums[task, 2] = adam_span(3 * begin, 3 * end, scales, beta1, beta2, step1, step2)
    sums[task, 3] = adam_span(begin, end, opacities, beta1, beta2, step1, step2)
    sums[task, 4] = adam_span(width * begin, width * end, sh, beta1, beta2, step1, step2)
    activate_means(3 * begin, 3 * end, means.raw, to)
    activate_scales(3 * begin, 3 * end, scales.raw, to)
    activate_opacities(begin, end, opacities.raw, to)
