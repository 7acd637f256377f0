"""Where an image still differs, new Gaussians are needed."""

import torch
from torch import Tensor

SHARPNESS = 1.5
"""Pixels are drawn in proportion to their error to this power: above 1 favours the worst."""


def sample_errors(error: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """At most ``count`` pixels [S, 2] (row, column), each once, likelier where ``error`` [H, W] is large."""
    weights = error.flatten().pow(SHARPNESS)
    count = min(count, int((weights > 0).sum()))
    if count == 0:
        return torch.zeros(0, 2, dtype=torch.long)
    # The smallest of exponential waiting times: a draw without replacement (Efraimidis & Spirakis, 2006).
    waiting = torch.empty_like(weights).exponential_(generator=generator) / weights
    index = waiting.topk(count, largest=False, sorted=False).indices.sort().values
    return torch.stack([index // error.shape[1], index % error.shape[1]], 1)
