"""Runs a kernel by several CPU threads at once, see `dwgs.splat.kernels.crew`.

A thread that Python hands its part begins some 50 us late and delays the one that did, in runs of two milliseconds.
So the threads that help stay in native code for a while after each run, where they see the next one begin.
"""

import atexit
import ctypes
import os
import threading
from collections.abc import Callable, Sequence
from functools import cache
from queue import SimpleQueue
from typing import Any

import numpy as np
import warp as wp

from dwgs.splat.kernels import crew as kernels

CORES = os.cpu_count() or 1
"""More threads than cores in a crew would wait for each other."""


def pack(kernel: Any, inputs: Sequence, threads: int) -> Callable[[], None]:
    """What runs a ``kernel``, whose first argument are the counters of a crew, again and again.

    Arrays among the ``inputs`` are kept alive; their memory is read and written at every run.
    """
    counters = np.zeros(kernels.SIZE, np.int32)
    work = _Entry(kernel, [_as_warp(counters), *inputs])
    helpers = min(threads, CORES) - 1
    run = np.array([work.address, *work.arguments, counters.ctypes.data, helpers], np.int64)
    lead = _Entry(kernels.lead, [_as_warp(_desk.memory), _as_warp(run)])
    keep = counters, work, run

    def go(_keep: Any = keep) -> None:
        _desk.call(helpers)
        lead()

    return go


class _Entry:
    """A kernel with its arguments, as native code calls it: Warp packs them anew at every launch, which takes 10 us."""

    def __init__(self, kernel: Any, inputs: Sequence) -> None:
        command: Any = wp.launch(kernel, 1, list(inputs), device="cpu", record_tape=False, record_cmd=True)
        self._bounds, *arguments = command.params
        self._arguments = _struct(*map(type, arguments))(*arguments)
        self._keep, self._call = (command, inputs), command.hooks.forward
        self.address = ctypes.cast(self._call, ctypes.c_void_p).value
        self.arguments = ctypes.addressof(self._bounds), ctypes.addressof(self._arguments)

    def __call__(self) -> None:
        self._call(ctypes.byref(self._bounds), ctypes.byref(self._arguments))


@cache
def _struct(*types: type) -> type[ctypes.Structure]:
    """What a kernel takes its arguments as."""
    return type("Arguments", (ctypes.Structure,), {"_fields_": [(f"_{k}", t) for k, t in enumerate(types)]})


class _Desk:
    """Where those who lead a crew find helpers."""

    def __init__(self) -> None:
        self.memory = np.zeros(kernels.DESK, np.int64)
        self._helpers: list[threading.Thread] = []
        self._bell: SimpleQueue[bool] = SimpleQueue()
        self._hiring = threading.Lock()

    def call(self, helpers: int) -> None:
        """Wake so many of those who have gone home, unless as many look out already."""
        missing = helpers - int(self.memory[kernels.WAITING])
        if missing > 0:
            if len(self._helpers) < helpers:
                self._hire(helpers)
            for _ in range(missing - self._bell.qsize()):  # those who were called are on their way
                self._bell.put(True)

    def close(self) -> None:
        """Wait for everybody to leave native code, which does not outlive the interpreter."""
        for _ in self._helpers:
            self._bell.put(False)
        for helper in self._helpers:
            helper.join()

    def _hire(self, helpers: int) -> None:
        with self._hiring:
            attend = _Entry(kernels.attend, [_as_warp(self.memory)])

            def work() -> None:
                while self._bell.get():
                    attend()

            while len(self._helpers) < helpers:
                self._helpers.append(threading.Thread(target=work, name="crew", daemon=True))
                self._helpers[-1].start()


def _as_warp(array: np.ndarray) -> wp.array:
    return wp.array(array, device="cpu", copy=False)


_desk = _Desk()
atexit.register(_desk.close)
