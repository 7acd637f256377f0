"""Warp launches on several CPU threads.

Warp's CPU launches are serial loops that release the GIL. There are two ways to share one. A kernel of one pass takes
``first`` as its first argument and works on item ``first + wp.tid()``; chunks of items are handed out. A kernel of
several passes is run once by every thread of a `crew`. Items are independent, so that results do not depend on
the number of threads; neither Warp's atomics nor its tiles are safe in threads.
"""

import itertools
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import torch
import warp as wp

from dwgs.splat.kernels import among_cpu, bin_cuda, composite_cpu, composite_cuda, crew, gather, project

CHUNKS_PER_THREAD = 4
"""Threads take chunks as they come, so one slow thread does not hold up the rest."""
BLOCK = 128
"""Threads per block of a GPU: twenty thousand Gaussians keep all of a large one busy."""

_MODULES = {"cpu": (project, among_cpu, composite_cpu, crew), "cuda": (project, bin_cuda, composite_cuda, gather)}
_loaded: set[str] = set()
_loading = threading.Lock()
_pool = ThreadPoolExecutor(max_workers=16, thread_name_prefix="splat")


def load(device: wp.Device) -> None:
    """Compile or load every kernel for ``device``: loads at the same time lose kernels, so once, alone."""
    if device.alias not in _loaded:
        with _loading:
            for module in _MODULES["cpu" if device.is_cpu else "cuda"]:
                wp.load_module(module.__name__, device=device)
            _loaded.add(device.alias)


@contextmanager
def torch_alone() -> Iterator[None]:
    """Torch computes on the calling thread alone: beside our threads its own come late, to work that is soon done."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def even(items: int, least: int, threads: int) -> list[int]:
    """Bounds [0, ..., items] of chunks for so many threads, each of ``least`` items or more."""
    chunks = max(1, min(threads * CHUNKS_PER_THREAD, items // least))
    return [items * k // chunks for k in range(chunks + 1)]


def launch(kernel: Any, bounds: Sequence[int], inputs: Sequence, device: wp.Device, threads: int) -> None:
    """Run ``kernel`` over items cut into chunks of equal work, by their ``bounds`` [0, ..., number of items]."""
    if bounds[-1] == 0:
        return
    if threads <= 1 or len(bounds) == 2 or not device.is_cpu:
        wp.launch(kernel, bounds[-1], [0, *inputs], device=device, block_dim=BLOCK, record_tape=False)
        return
    spans = iter([(a, b) for a, b in itertools.pairwise(bounds) if a < b])  # each span goes to one thread

    def record() -> Any:
        return wp.launch(kernel, dim=1, inputs=[0, *inputs], device=device, record_tape=False, record_cmd=True)

    def work(command: Any = None) -> None:
        command = command or record()
        for begin, end in spans:
            command.set_param_at_index(0, begin)
            command.set_dim(end - begin)
            command.launch()

    own = record()  # alone: it may load the kernel, and two that do so at the same time lose it
    others = [_pool.submit(work) for _ in range(threads - 1)]
    work(own)
    for other in others:
        if not other.cancel():  # a thread that has not begun by now has nothing left to do
            other.result()
