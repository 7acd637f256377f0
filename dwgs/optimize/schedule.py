"""Which view next, and how large a step."""

import math
from collections.abc import Iterator

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


def hold_then_decay(step: int, steps: int, hold: float = 0.6, final: float = 0.05) -> float:
    """Factor on the rates: 1 for the first ``hold`` of the schedule, then exponentially down to ``final``."""
    progress = (step / steps - hold) / (1 - hold)
    return final ** min(max(progress, 0.0), 1.0)
