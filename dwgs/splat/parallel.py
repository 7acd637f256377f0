"""Warp launches on several CPU threads.

Warp's CPU launches are serial loops that release the GIL. A kernel made for this takes ``first`` as its first argument
and works on item ``first + wp.tid()``; items are independent, so results do not depend on the number of threads.
Such kernels use no atomics and no tiles: on a CPU neither is safe in threads.
"""

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import warp as wp

from dwgs.splat.kernels import bin, composite_cpu, gather, project

wp.init()

_MODULES = (bin, composite_cpu, gather, project)
_CHUNKS_PER_THREAD = 4
_loaded: set[str] = set()
_loading = threading.Lock()
_pool = ThreadPoolExecutor(max_workers=16, thread_name_prefix="splat")


def load(device: wp.Device) -> None:
    """Compile or load every kernel for ``device``: concurrent loads lose kernels, so this happens once, alone."""
    if device.alias not in _loaded:
        with _loading:
            for module in _MODULES:
                wp.load_module(module.__name__, device=device)
            _loaded.add(device.alias)


def launch(
    kernel: wp.Kernel, items: int | Sequence[int], inputs: Sequence, device: wp.Device, threads: int
) -> None:
    """Run ``kernel`` over ``items``: their number, or the bounds [0, ..., number] of chunks of equal work."""
    bounds = (0, items) if isinstance(items, int) else tuple(items)
    count = bounds[-1]
    if count == 0:
        return
    if threads <= 1 or not device.is_cpu:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], device=device, record_tape=False)
        return
    if isinstance(items, int):
        chunks = min(threads * _CHUNKS_PER_THREAD, count)
        bounds = [count * k // chunks for k in range(chunks + 1)]
    spans = iter([(a, b) for a, b in zip(bounds[:-1], bounds[1:], strict=True) if a < b])

    def work(command: wp.Launch) -> None:
        for begin, end in spans:  # the iterator of a list hands each span to one thread
            command.set_param_at_index(0, begin)
            command.set_dim(end - begin)
            command.launch()

    commands = [
        wp.launch(kernel, dim=1, inputs=[0, *inputs], device=device, record_tape=False, record_cmd=True)
        for _ in range(threads)
    ]
    others = [_pool.submit(work, command) for command in commands[1:]]
    work(commands[0])
    for other in others:
        other.result()
