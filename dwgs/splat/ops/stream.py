"""Warp on torch's stream, so that neither has to wait for the other."""

from contextlib import AbstractContextManager, nullcontext

import torch
import warp as wp


def torch_stream(where: torch.device) -> AbstractContextManager:
    """Within it, Warp's launches, sorts and scans queue behind torch's work on that device."""
    return wp.ScopedStream(wp.stream_from_torch(where)) if where.type == "cuda" else nullcontext()
