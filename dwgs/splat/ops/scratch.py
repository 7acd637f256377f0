"""Memory that lives from call to call, because fresh pages cost more than the work done in them."""

import threading

import torch
from torch import Tensor

_GROWTH = 1.25

_local = threading.local()


def scratch(name: str, size: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """[size] elements of any content, valid until this thread next asks for ``name`` on that device."""
    buffers: dict = _local.__dict__.setdefault("buffers", {})
    key = (name, dtype, device)
    if key not in buffers or len(buffers[key]) < size:
        buffers[key] = torch.empty(int(size * _GROWTH), dtype=dtype, device=device)
    return buffers[key][:size]


def largest(name: str, size: int) -> int:
    """A little more than the largest ``size`` that this thread ever named so."""
    sizes: dict[str, int] = _local.__dict__.setdefault("sizes", {})
    if sizes.get(name, -1) < size:
        sizes[name] = int(size * _GROWTH)
    return sizes[name]
