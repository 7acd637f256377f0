"""From a file's units and axes to ours: what the format states, else what a vehicle can be."""

from itertools import pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import InputError
from generator.conditions.surface import AXES, UNITS, Convention, Surface

LENGTH, WIDTH, HEIGHT = (2.5, 14.0), (1.4, 3.0), (1.1, 4.2)
"""What a vehicle measures [m]: from a micro car to a truck that roads admit, mirrors included."""

_UP_HABITS = ("z", "y", "x")  # of tools that state nothing
_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "inch": "inches", "feet": "feet"}


def convention_of(surface: Surface, name: str, unit: str | None, forward: str | None) -> tuple[Convention, str]:
    """The convention that makes a vehicle of the surface, and in words what of it was assumed.

    Args:
        surface: In the file's frame.
        name: What messages call it.
        unit: One of `UNITS`, to set it.
        forward: One of `AXES`, to set it.

    Raises:
        InputError: No unit makes it a vehicle, or ``unit`` or ``forward`` is unknown or makes none.
    """
    if unit is not None and unit not in UNITS:
        raise InputError(f"--unit is one of {', '.join(UNITS)}, not '{unit}'")
    if forward is not None and forward not in AXES:
        raise InputError(f"--forward is one of {', '.join(AXES)}, not '{forward}'")

    extents = np.ptp(surface.points, axis=0)
    units = [unit] if unit else list(UNITS)
    if surface.stated and not unit:
        units = [surface.stated.unit, *(u for u in units if u != surface.stated.unit)]
    fits = [
        (u, length, width, height)
        for u in units
        for length, width, height in permutations("xyz")
        if _is_vehicle(extents * UNITS[u], (length, width, height))
    ]
    if forward:
        fits = [fit for fit in fits if fit[1] == forward[-1]]
    if not fits:
        told = ", ".join(f"--{k} {v}" for k, v in (("unit", unit), ("forward", forward)) if v)
        size = " x ".join(f"{e:.4g}" for e in extents)
        raise InputError(
            f"a vehicle is {LENGTH[0]:g}-{LENGTH[1]:g} m long, {WIDTH[0]:g}-{WIDTH[1]:g} m wide and "
            f"{HEIGHT[0]:g}-{HEIGHT[1]:g} m high, {name} measures {size} (x, y, z) in its own unit and is "
            f"none with {told or 'any unit'}; set --unit and --forward or scale it"
        )
    fits = [fit for fit in fits if fit[0] == fits[0][0]]

    stated = surface.stated
    if stated and (fits[0][0], stated.forward, stated.up) in [(u, a, c) for u, a, _, c in fits]:
        return Convention(fits[0][0], stated.up, forward or stated.forward), ""
    what = "forward" if stated or unit else "unit and forward"
    found, along, _, up = min(fits, key=lambda fit: _strangeness(surface, fit[2], fit[3], stated))
    if forward:
        return Convention(found, up, forward), "" if stated or unit else "unit assumed from its size"
    slope = _slope(surface.points, along, up)
    if abs(slope) > 0.05:
        return Convention(found, up, ("" if slope > 0 else "-") + along), f"{what} assumed from its size and shape"
    return Convention(found, up, along), f"{what} assumed from its size, front and rear look alike"


def matrix(convention: Convention) -> NDArray[np.float64]:
    """``vehicle_from_source`` [3, 3]: axes and unit, without the origin."""
    forward = np.array(AXES[convention.forward], np.float64)
    up = np.array(AXES[convention.up], np.float64)
    return UNITS[convention.unit] * np.stack([forward, np.cross(up, forward), up])


def describe(convention: Convention, size: NDArray, assumed: str) -> str:
    """The convention in words, with the size it leads to."""
    dimensions = " x ".join(f"{s:.2f}" for s in size)
    signed = [axis if axis[0] == "-" else "+" + axis for axis in (convention.up, convention.forward)]
    words = f"{_NAMES[convention.unit]} ({dimensions} m), up {signed[0]}, forward {signed[1]}"
    return f"{words} ({assumed}; --unit, --forward override)" if assumed else words


def _is_vehicle(size: NDArray, axes: tuple[str, ...]) -> bool:
    length, width, height = (size["xyz".index(axis)] for axis in axes)
    within = all(
        low <= s <= high for s, (low, high) in zip((length, width, height), (LENGTH, WIDTH, HEIGHT), strict=True)
    )
    return bool(within and length > width and length > height)


def _strangeness(surface: Surface, across: str, up: str, stated: Convention | None) -> float:
    """How odd it would be if ``across`` went from side to side: a vehicle is mirrored there alone."""
    habits = (stated.up, *_UP_HABITS) if stated else _UP_HABITS
    return 0.15 * habits.index(up) - _symmetry(surface.points, "xyz".index(across))


def _symmetry(points: NDArray, axis: int) -> float:
    """Share of occupied cells whose mirror image across the middle of ``axis`` is occupied too."""
    low, high = points.min(0), points.max(0)
    cells = 32
    index = np.minimum((points - low) / (high - low).max() * cells, cells - 1e-6)
    index[:, axis] -= (high - low)[axis] / (high - low).max() * cells / 2  # cells meet at the middle
    index = np.floor(index).astype(int) + cells
    filled = np.zeros((2 * cells,) * 3, bool)
    filled[tuple(index.T)] = True
    index[:, axis] = 2 * cells - 1 - index[:, axis]
    return float(filled[tuple(index.T)].mean())


def _slope(points: NDArray, along: str, up: str) -> float:
    """How much higher the rear stands than the front if ``along`` points forward, as a share of the height.

    Bonnets are lower than boots, beds and boxes; where both ends are level this says nothing.
    """
    x, z = points[:, "xyz".index(along)], points[:, "xyz".index(up)]
    x = (x - x.min()) / np.ptp(x)
    z = (z - z.min()) / np.ptp(z)

    def top(first: float, last: float) -> float:
        edges = np.linspace(first, last, 9)
        slices = [z[(x >= a) & (x < b)] for a, b in pairwise(edges)]
        return float(np.mean([np.quantile(s, 0.98) for s in slices if len(s)] or [0]))

    return top(0.03, 0.22) - top(0.78, 0.97)
