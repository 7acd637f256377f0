# type: ignore  (Warp's language, which is not Python's)
"""Adam (Kingma and Ba 2015) in one pass over memory, on a GPU: one number per thread."""

import warp as wp

from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})


@wp.struct
class Group:
    """Parameters that share a derivative; of every ``period`` the first three step at ``rate``."""

    raw: wp.array(dtype=float)
    moment: wp.array(dtype=float)
    """Running mean of the gradient."""
    variance: wp.array(dtype=float)
    """Running mean of its square."""
    derivative: wp.array(dtype=float)
    """Of the activated by the raw parameter; empty: 1."""
    rate: float
    rest_rate: float
    period: int


@wp.kernel
def adam(
    group: Group,
    gradient: wp.array(dtype=float),
    clock: wp.array(dtype=float),
    stills: wp.array(dtype=float),
    beta1: float,
    beta2: float,
):
    """One step. What changes from step to step is read from memory, so that a captured one can be replayed.

    ``clock`` holds the number of the step and a factor on the rates, ``stills`` Adam's epsilon for the first three
    of a period and for the rest.
    """
    i = wp.tid()
    g = gradient[i]
    if group.derivative.shape[0] > 0:
        g *= group.derivative[i]
    m = beta1 * group.moment[i] + (1.0 - beta1) * g
    v = beta2 * group.variance[i] + (1.0 - beta2) * g * g
    group.moment[i] = m
    group.variance[i] = v
    rate = group.rate
    still = stills[0]
    if i % group.period >= 3:
        rate = group.rest_rate
        still = stills[1]
    steps = clock[0]
    unbiased = m / (1.0 - wp.pow(beta1, steps))
    scale = wp.sqrt(v / (1.0 - wp.pow(beta2, steps)))
    group.raw[i] = group.raw[i] - rate * clock[1] * unbiased / (scale + still)
