"""How sure a mean over a few sequences is."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

LEVEL = 0.95
"""An interval holds this share of the resampled values."""

T = TypeVar("T")


def bootstrap_interval(
    sequences: Sequence[T], pool: Callable[[Sequence[T]], float], samples: int = 1000, seed: int = 0
) -> tuple[float, float] | None:
    """Percentile interval of ``pool(sequences)`` under drawing sequences with replacement (Efron 1979).

    None for fewer than two sequences: nothing says how they vary.
    """
    if len(sequences) < 2:
        return None
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(sequences), size=(samples, len(sequences)))
    values = [pool([sequences[i] for i in draw]) for draw in draws]
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method="inverted_cdf")
    return float(low), float(high)
