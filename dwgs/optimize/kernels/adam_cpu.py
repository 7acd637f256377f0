# type: ignore  (Warp's language, which is not Python's)
"""Adam (Kingma and Ba 2015), if wanted of gradients whose trend is amplified (Grokfast, Lee et al. 2024), in one pass
over memory, on a CPU: sixteen numbers per instruction."""

import warp as wp

from dwgs.optimize.kernels.activation import Activation, activate_means, activate_opacities, activate_scales
from dwgs.splat.kernels.crew import close_phase, is_leader, open_phase, take
from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})

SPAN = 1024
"""Gaussians that are one item."""
LANES = 16
"""Numbers per instruction."""
vec6 = wp.types.vector(length=6, dtype=float)


@wp.struct
class Group:
    """Parameters that share a derivative; of every ``period`` the first three are usual, the others rest."""

    raw: wp.array(dtype=float)
    moment: wp.array(dtype=float)
    """Running mean of the gradient and its trend."""
    variance: wp.array(dtype=float)
    """Running mean of its square."""
    trend: wp.array(dtype=float)
    """Slower running mean of the gradient, which is added to it; empty: none is."""
    derivative: wp.array(dtype=float)
    """Of the activated by the raw parameter; empty: 1."""
    gradient: wp.array(dtype=float)
    """By the activated parameter; empty: nothing moves."""
    is_rest: wp.array(dtype=float)
    """[period + LANES] 0 or 1, again and again."""
    period: int


@wp.func_native("""
    typedef float block __attribute__((vector_size(64)));
    typedef float loose __attribute__((vector_size(64), aligned(4)));
    if (group.gradient.shape[0] == 0) return wp::vec2(0.0f, 0.0f);
    const bool derived = group.derivative.shape[0] > 0;
    const float rate = numbers[0], rest_rate = numbers[1], still = numbers[2], rest_still = numbers[3];
    const float step1 = numbers[4], step2 = numbers[5];
    const bool trends = group.trend.shape[0] > 0;
    auto advance = [&](auto g, auto d, auto& raw, auto& m, auto& v, auto& t, auto own_rate, auto own_still, auto root) {
        g *= d;
        t = trend_beta * t + (1.0f - trend_beta) * g;
        g += trend_weight * t;
        m = beta1 * m + (1.0f - beta1) * g;
        v = beta2 * v + (1.0f - beta2) * g * g;
        raw -= own_rate * step1 * m / (root(v) * step2 + own_still);
    };
    block all = {}, rest = {};
    int i = begin;
    for (; i + 16 <= end; i += 16) {
        auto load = [](const float* at) -> block { return *(const loose*)at; };
        const int p = i % group.period;
        block raw = load(group.raw.data + i), m = load(group.moment.data + i), v = load(group.variance.data + i);
        block t = trends ? load(group.trend.data + i) : block{};
        const block d = derived ? load(group.derivative.data + i) : block{} + 1.0f, r = load(group.is_rest.data + p);
        advance(load(group.gradient.data + i), d, raw, m, v, t, rate + r * (rest_rate - rate),
                still + r * (rest_still - still), [](block x) -> block { return __builtin_elementwise_sqrt(x); });
        *(loose*)(group.raw.data + i) = raw;
        *(loose*)(group.moment.data + i) = m;
        *(loose*)(group.variance.data + i) = v;
        if (trends) *(loose*)(group.trend.data + i) = t;
        all += v;
        rest += v * r;
    }
    float total = 0.0f, total_rest = 0.0f;
    for (int lane = 0; lane < 16; ++lane) total += all[lane], total_rest += rest[lane];
    for (; i < end; ++i) {
        const int p = i % group.period;
        const bool r = group.is_rest.data[p] > 0.0f;
        float raw = group.raw.data[i], m = group.moment.data[i], v = group.variance.data[i];
        float t = trends ? group.trend.data[i] : 0.0f;
        advance(group.gradient.data[i], derived ? group.derivative.data[i] : 1.0f, raw, m, v, t, r ? rest_rate : rate,
                r ? rest_still : still, [](float x) -> float { return __builtin_sqrtf(x); });
        group.raw.data[i] = raw;
        group.moment.data[i] = m;
        group.variance.data[i] = v;
        if (trends) group.trend.data[i] = t;
        total += v;
        total_rest += r ? v : 0.0f;
    }
    return wp::vec2(total - total_rest, total_rest);
""")
def adam_span(
    begin: int,
    end: int,
    group: Group,
    numbers: vec6,
    beta1: float,
    beta2: float,
    trend_beta: float,
    trend_weight: float,
) -> wp.vec2:
    """One step for the parameters [begin, end); the sums of both classes' new variances."""


@wp.kernel
def adam(
    crew: wp.array(dtype=int),
    means: Group,
    quats: Group,
    scales: Group,
    opacities: Group,
    sh: Group,
    numbers: wp.array(dtype=vec6),
    beta1: float,
    beta2: float,
    trend_beta: float,
    trend_weight: float,
    # outputs
    to: Activation,
    sums: wp.array2d(dtype=wp.vec2),
):
    """One step, and the Gaussians it leads to, once per thread of the crew.

    ``numbers`` are by group the rates of both classes, their stillness (below it a gradient moves its parameter in
    proportion only: Adam's epsilon), and what undoes both moments' start at zero. ``sums`` are by span and group those
    of the new variances.
    """
    leads = is_leader(crew)
    open_phase(crew, 0, leads, sums.shape[0])
    span = take(crew, 0, leads, -1)
    while span >= 0:
        begin = span * SPAN
        end = wp.min(begin + SPAN, opacities.raw.shape[0])
        width = sh.period
        sums[span, 0] = adam_span(3 * begin, 3 * end, means, numbers[0], beta1, beta2, trend_beta, trend_weight)
        sums[span, 1] = adam_span(4 * begin, 4 * end, quats, numbers[1], beta1, beta2, trend_beta, trend_weight)
        sums[span, 2] = adam_span(3 * begin, 3 * end, scales, numbers[2], beta1, beta2, trend_beta, trend_weight)
        sums[span, 3] = adam_span(begin, end, opacities, numbers[3], beta1, beta2, trend_beta, trend_weight)
        sums[span, 4] = adam_span(width * begin, width * end, sh, numbers[4], beta1, beta2, trend_beta, trend_weight)
        activate_means(3 * begin, 3 * end, means.raw, to)
        activate_scales(3 * begin, 3 * end, scales.raw, to)
        activate_opacities(begin, end, opacities.raw, to)
        span = take(crew, 0, leads, span)
    close_phase(crew, 0, leads)
