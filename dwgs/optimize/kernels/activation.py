# type: ignore  (Warp's language, which is not Python's)
"""Parameters to the Gaussians they stand for: one text for both devices, see `dwgs.splat.kernels.lanes`.

A parameter that has left its bounds is put back: it does not wander where nothing sees it, and finds back at once.
"""

import warp as wp

from dwgs.splat.kernels.lanes import NUMBERS
from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})


@wp.struct
class Activation:
    """Gaussians, and what bounds them; numbers that every Gaussian has three of lie one Gaussian after the other.

    ``lows``, ``highs`` and ``log_most`` go round: three values again and again, as many as a number has lanes and
    three more.
    """

    origins: wp.array(dtype=float)
    """Where the means began [m]."""
    strides: wp.array(dtype=float)
    """How far a mean goes with its parameter [m]."""
    means: wp.array(dtype=float)
    scales: wp.array(dtype=float)
    opacities: wp.array(dtype=float)
    opacity_derivative: wp.array(dtype=float)
    """Of an opacity by its logit."""
    lows: wp.array(dtype=float)
    highs: wp.array(dtype=float)
    log_most: wp.array(dtype=float)
    """Logarithm of the largest scales."""


@wp.func_native(f"""
{NUMBERS}
    for (int i = begin; i < end; i += lanes) {{
        const number low = get(to.lows.data, 1, 0, i % 3, 1 << 30), high = get(to.highs.data, 1, 0, i % 3, 1 << 30);
        const number origin = get(to.origins.data, 1, 0, i, end), stride = get(to.strides.data, 1, 0, i, end);
        const number way = get(raw.data, 1, 0, i, end), free = origin + way * stride;
        const number mean = lower(higher(free, low), high);
        put(to.means.data, 1, 0, i, end, mean);
        put(raw.data, 1, 0, i, end, mean == free ? way : (mean - origin) / stride);
    }}
""")
def activate_means(begin: int, end: int, raw: wp.array(dtype=float), to: Activation):
    """Of numbers [begin, end)."""


@wp.func_native(f"""
{NUMBERS}
    for (int i = begin; i < end; i += lanes) {{
        const number most = get(to.log_most.data, 1, 0, i % 3, 1 << 30);
        const number log_scale = lower(get(raw.data, 1, 0, i, end), most);
        put(raw.data, 1, 0, i, end, log_scale);
        put(to.scales.data, 1, 0, i, end, exponential(log_scale));
    }}
""")
def activate_scales(begin: int, end: int, raw: wp.array(dtype=float), to: Activation):
    """Of numbers [begin, end)."""


@wp.func_native(f"""
{NUMBERS}
    for (int i = begin; i < end; i += lanes) {{
        const number opacity = 1.0f / (1.0f + exponential(zero - get(raw.data, 1, 0, i, end)));
        put(to.opacities.data, 1, 0, i, end, opacity);
        put(to.opacity_derivative.data, 1, 0, i, end, opacity * (1.0f - opacity));
    }}
""")
def activate_opacities(begin: int, end: int, raw: wp.array(dtype=float), to: Activation):
    """Of numbers [begin, end)."""


@wp.kernel
def activate(
    first: int,
    size: int,
    means: wp.array(dtype=float),
    scales: wp.array(dtype=float),
    opacities: wp.array(dtype=float),
    # outputs
    to: Activation,
):
    """All of so many Gaussians per task, from their parameters."""
    begin = (first + wp.tid()) * size
    end = wp.min(begin + size, opacities.shape[0])
    activate_means(3 * begin, 3 * end, means, to)
    activate_scales(3 * begin, 3 * end, scales, to)
    activate_opacities(begin, end, opacities, to)
