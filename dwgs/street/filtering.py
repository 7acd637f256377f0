# type: ignore  (Warp compiles this file, and its types are not Python's)
"""Patterns averaged over the footprint of a pixel: exact for bars and joints, faded for noise."""

import warp as wp


@wp.func
def bar(x: float, width: float, low: float, high: float) -> float:
    """Share of a window of this width about x that lies between low and high."""
    return wp.clamp((wp.min(x + 0.5 * width, high) - wp.max(x - 0.5 * width, low)) / width, 0.0, 1.0)


@wp.func
def bars_below(x: float, period: float, low: float, high: float) -> float:
    """Length covered, between 0 and x, by bars that repeat with a period."""
    cell = wp.floor(x / period)
    return cell * (high - low) + wp.clamp(x - cell * period - low, 0.0, high - low)


@wp.func
def bars(x: float, width: float, period: float, low: float, high: float) -> float:
    """Share of a window of this width about x covered by bars that repeat with a period."""
    above = bars_below(x + 0.5 * width, period, low, high)
    return wp.clamp((above - bars_below(x - 0.5 * width, period, low, high)) / width, 0.0, 1.0)


@wp.func
def fade(width: float, period: float) -> float:
    """How much of a ripple of this period is left when seen through a window of this width."""
    return 1.0 - wp.smoothstep(0.3, 0.9, width / period)


@wp.func
def ripple2(seed: wp.uint32, p: wp.vec2, width: float, period: float) -> float:
    """Noise in about [-1, 1] with features of half a period, faded before it aliases."""
    keep = fade(width, period)
    if keep <= 0.0:
        return 0.0
    return 1.6 * keep * wp.noise(seed, p / period)


@wp.func
def ripple3(seed: wp.uint32, p: wp.vec3, width: float, period: float) -> float:
    """`ripple2` in space."""
    keep = fade(width, period)
    if keep <= 0.0:
        return 0.0
    return 1.6 * keep * wp.noise(seed, p / period)


@wp.func
def dice(seed: wp.uint32, i: float, j: float) -> float:
    """A number in [0, 1) that belongs to a cell."""
    state = wp.rand_init(int(seed), int(i) * 7919 + int(j) * 104729 + 13)
    return wp.randf(state)
