# type: ignore  (Warp's language, which is not Python's)
"""Adam (Kingma and Ba 2015), if wanted of gradients whose trend is amplified (Grokfast, Lee et al. 2024), in one pass
over memory, on a GPU: one launch for all groups, one number per thread."""

import warp as wp

from dwgs.optimize.kernels.activation import Activation, activate_means, activate_opacities, activate_scales
from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})


@wp.struct
class Group:
    """Parameters that share a derivative; of every ``period`` the first three step at ``rate``."""

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
    rate: float
    rest_rate: float
    period: int


@wp.func
def advance(
    group: Group,
    i: int,
    clock: wp.array(dtype=float),
    stills: wp.array(dtype=float),
    beta1: float,
    beta2: float,
    trend_beta: float,
    trend_weight: float,
):
    """One step of one number."""
    g = group.gradient[i]
    if group.derivative.shape[0] > 0:
        g *= group.derivative[i]
    if group.trend.shape[0] > 0:
        t = trend_beta * group.trend[i] + (1.0 - trend_beta) * g
        group.trend[i] = t
        g += trend_weight * t
    m = beta1 * group.moment[i] + (1.0 - beta1) * g
    v = beta2 * group.variance[i] + (1.0 - beta2) * g * g
    group.moment[i] = m
    group.variance[i] = v
    rate = group.rate
    still = stills[0]
    if i % group.period >= 3:
        rate = group.rest_rate
        still = stills[1]
    group.raw[i] = group.raw[i] - rate * clock[1] * clock[2] * m / (wp.sqrt(v) * clock[3] + still)


@wp.kernel
def adam(
    means: Group,
    quats: Group,
    scales: Group,
    opacities: Group,
    sh: Group,
    clock: wp.array(dtype=float),
    stills: wp.array2d(dtype=float),
    beta1: float,
    beta2: float,
    trend_beta: float,
    trend_weight: float,
    # outputs
    to: Activation,
):
    """One step, and the Gaussians it leads to.

    What changes from step to step is read from memory, so that a captured one can be replayed.

    ``clock`` is as `tick` left it, ``stills`` holds by group Adam's epsilon for the first three of a period and for
    the rest.
    """
    i = wp.tid()
    if i < means.gradient.shape[0]:
        advance(means, i, clock, stills[0], beta1, beta2, trend_beta, trend_weight)
        activate_means(i, i + 1, means.raw, to)
    i -= means.gradient.shape[0]
    if i >= 0 and i < quats.gradient.shape[0]:
        advance(quats, i, clock, stills[1], beta1, beta2, trend_beta, trend_weight)
    i -= quats.gradient.shape[0]
    if i >= 0 and i < scales.gradient.shape[0]:
        advance(scales, i, clock, stills[2], beta1, beta2, trend_beta, trend_weight)
        activate_scales(i, i + 1, scales.raw, to)
    i -= scales.gradient.shape[0]
    if i >= 0 and i < opacities.gradient.shape[0]:
        advance(opacities, i, clock, stills[3], beta1, beta2, trend_beta, trend_weight)
        activate_opacities(i, i + 1, opacities.raw, to)
    i -= opacities.gradient.shape[0]
    if i >= 0 and i < sh.gradient.shape[0]:
        advance(sh, i, clock, stills[4], beta1, beta2, trend_beta, trend_weight)


@wp.kernel
def tick(clock: wp.array(dtype=float), beta1: float, beta2: float):
    """Count a step: how many there were, a factor on the rates, and what undoes the moments' start at zero."""
    clock[0] = clock[0] + 1.0
    clock[2] = 1.0 / (1.0 - wp.pow(beta1, clock[0]))
    clock[3] = 1.0 / wp.sqrt(1.0 - wp.pow(beta2, clock[0]))
