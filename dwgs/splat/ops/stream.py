"""Warp on torch's stream, so that neither has to wait for the other."""

from contextlib import AbstractContextManager, nullcontext
from functools import cache

import torch
import warp as wp


def torch_stream(where: torch.device) -> AbstractContextManager:
    """Within it, Warp's launches and sorts queue behind torch's work on that device."""
    if where.type != "cuda":
        return nullcontext()
    stream = torch.cuda.current_stream(where)
    return wp.ScopedStream(known(str(stream.device), stream.cuda_stream), sync_enter=False)


@cache
def known(device: str, handle: int) -> wp.Stream:
    """Warp's name for a stream, always the same: a second one takes the graph away that the first is capturing."""
    return wp.Stream(device, cuda_stream=handle)
