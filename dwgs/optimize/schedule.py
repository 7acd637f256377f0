"""Which view next, how large a step, and when it is over."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

GOLDEN_RATIO = (math.sqrt(5) - 1) / 2


def view_order(count: int, seed: int = 0) -> Iterator[int]:
    """Indices of ``count`` views sorted along the path, endlessly, each exactly once in any ``count`` draws.

    Steps by the number coprime to ``count`` nearest to the golden section, so that any few views in a row are
    spread evenly over the clip: an optimiser with a short memory then always sees the whole of it.
    """
    coprime = [stride for stride in range(1, count + 1) if math.gcd(stride, count) == 1]
    stride = min(coprime, key=lambda s: abs(s - GOLDEN_RATIO * count))
    position = seed % count
    while True:
        yield position
        position = (position + stride) % count


def hold_then_decay(progress: float, hold: float = 0.6, final: float = 0.05) -> float:
    """Factor on the rates: 1 for the first ``hold`` of the schedule, then exponentially down to ``final``."""
    return final ** min(max((progress - hold) / (1 - hold), 0.0), 1.0)


@dataclass(frozen=True)
class Pace:
    """Where in its schedule a step is."""

    step: int
    """Counted from 1."""
    steps: int
    """Length of the schedule; an estimate where time ends it."""
    progress: float
    """From 0 to 1, which the last step has."""


def count_steps(steps: int) -> Iterator[Pace]:
    """A schedule of so many steps."""
    for step in range(1, steps + 1):
        yield Pace(step, steps, step / steps)


def fill_time(seconds: float, clock: Callable[[], float] = time.monotonic) -> Iterator[Pace]:
    """As many steps as fit into so many seconds from now, and one more: its rates fell as the time ran out."""
    begin, step, progress = clock(), 0, 0.0
    while progress < 1:
        step += 1
        progress = min((clock() - begin) / seconds, 1.0)
        yield Pace(step, max(step, round(step / max(progress, 1e-3))), progress)
