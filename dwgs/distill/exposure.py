"""Which points of a vehicle show, before anything is drawn: those that no nearer one hides."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

SIDES, LOWEST, FAR = 16, -0.05, 10.0
"""So many eyes, evenly from this sine of an elevation up to the zenith, this many lengths away, see whatever is not
inside."""
COVER = 12
"""A square of a view hides what lies behind it if so many points fall into it, were all of them on the box ..."""
LAYER = 1.5
"""... and that deeper than this, in widths of a square ..."""
FINEST = 0.01
"""... which is not narrower than this [m]."""
NEAREST, WIDEST = 0.5, 2.0
"""Before an eye [m], and to its sides, in depths: what lies nearer or further aside is not asked for."""


def is_exposed(points: NDArray) -> NDArray[np.bool_]:
    """[P] which points show from any side: not those of seats and of the insides of doors."""
    sines = LOWEST + (1 - LOWEST) * (np.arange(SIDES) + 0.5) / SIDES
    turns, cosines = np.pi * (1 + 5**0.5) * np.arange(SIDES), np.sqrt(1 - sines**2)
    toward = np.stack([cosines * np.cos(turns), cosines * np.sin(turns), sines], 1)
    center, length = _middle(points), np.ptp(points, axis=0).max()
    return is_seen(points, center + FAR * max(length, 2 * NEAREST) * toward)


def is_seen(points: NDArray, eyes: Iterable[NDArray]) -> NDArray[np.bool_]:
    """[P] which points any of the eyes [3] sees, all in one frame [m]."""
    center = _middle(points)
    length, width, height = np.ptp(points, axis=0)
    area = 2 * (length * width + width * height + height * length)
    side = max(np.sqrt(COVER * area / len(points)), FINEST)
    seen = np.zeros(len(points), bool)
    for eye in eyes:
        away = center - eye
        distance = max(np.linalg.norm(away), NEAREST)
        forward = away / distance
        right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
        right /= max(np.linalg.norm(right), FINEST)
        axes = np.stack([right, np.cross(right, forward), forward]).astype(np.float32)
        x, y, depth = axes @ (points - np.asarray(eye, np.float32)).T
        within = (depth > NEAREST) & (np.maximum(np.abs(x), np.abs(y)) < WIDEST * depth)
        if not within.any():
            continue
        x, y, depth = x[within], y[within], depth[within]
        across, down = (a * (np.float32(distance / side) / depth) for a in (x, y))
        column, row = ((a - a.min()).astype(np.int32) for a in (across, down))
        cell = row * (column.max() + 1) + column
        nearest = np.full(cell.max() + 1, np.inf, np.float32)
        np.minimum.at(nearest, cell, depth)
        seen[within] |= depth < nearest[cell] + LAYER * side
    return seen


def _middle(points: NDArray) -> NDArray[np.float64]:
    """[3] of their box."""
    return (points.min(0).astype(np.float64) + points.max(0)) / 2
