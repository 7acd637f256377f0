"""The compositing loops in plain C++, compiled for this CPU when first asked for."""

import ctypes
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from math import log
from pathlib import Path

import torch
from torch import Tensor

from dwgs.splat import View
from dwgs.splat.constants import MAX_ALPHA, MIN_ALPHA, STOP_TRANSMITTANCE
from dwgs.splat.ops.binned import Binned

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fPIC")
_CONSTANTS = {"MAX_ALPHA": MAX_ALPHA, "STOP_TRANSMITTANCE": STOP_TRANSMITTANCE, "LOG_MIN_ALPHA": log(MIN_ALPHA)}
_RECORDS = ("records", "ranges", "isect_from_sorted", "gaussian_from_isect", "ends")


class _Job(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in _RECORDS),
        *((name, ctypes.c_int) for name in ("width", "height", "gaussians")),
    )


@dataclass(frozen=True)
class Count:
    """Work of the forward loop."""

    lanes: int
    """Pixels evaluated, sixteen per block visited."""
    live: int
    """Of these, drawn: alpha at least 1/255 where light is left."""


class Cpp:
    """One image of records [N, 16], on one thread, into memory that is there before."""

    def __init__(self, records: Tensor, binned: Binned, view: View) -> None:
        self._library = _library()
        self._tensors = (records.detach(), *(getattr(binned, name) for name in _RECORDS[1:]))
        self._job = _Job(*(t.data_ptr() for t in self._tensors), view.width, view.height, len(records))
        across, down = view.tiles
        self.image = torch.zeros(5, 16 * down, 16 * across)
        """[5, H', W'] r, g, b, depth, alpha, of whole tiles."""
        self.slots = torch.zeros(len(binned.isect_from_sorted), 10)
        """[M, 10] gradient of a record's first ten fields by intersection."""
        self.v_records = torch.zeros(len(records), 16)
        """[N, 16] their sums by Gaussian."""

    @property
    def is_limit(self) -> bool:
        """Whether the loop was compiled for registers as wide as its vectors; else it is right, but slow."""
        return self._library.is_limit()

    def composite(self) -> None:
        """Draw ``image``."""
        self._call("composite", self.image)

    def composite_adjoint(self, v_image: Tensor) -> None:
        """Fill ``slots`` and ``v_records`` from ``image`` and its gradient [5, H', W']."""
        self._call("composite_adjoint", self.image, v_image, self.slots)
        self._call("gather", self.slots, self.v_records)

    def count(self) -> Count:
        """Draw ``image`` once more and count."""
        counts = torch.zeros(2, dtype=torch.int64)
        self._call("count", self.image, counts)
        return Count(*counts.tolist())

    def _call(self, name: str, *tensors: Tensor) -> None:
        getattr(self._library, name)(ctypes.byref(self._job), *(ctypes.c_void_p(t.data_ptr()) for t in tensors))


@cache
def _library() -> ctypes.CDLL:
    """Linked without the flags: with ``-ffast-math`` the library would turn off denormals for the whole process."""
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        raise FileNotFoundError("the C++ rival is compiled on the spot, but there is no c++ or g++; install g++ >= 12")
    defines = [f"-D{name}={value!r}f" for name, value in _CONSTANTS.items()]
    with tempfile.TemporaryDirectory(prefix="dwgs-rival-") as folder:
        compiled, linked = f"{folder}/composite.o", f"{folder}/composite.so"
        source = Path(__file__).with_name("composite.cpp")
        subprocess.run([compiler, *FLAGS, *defines, "-c", source, "-o", compiled], check=True)
        subprocess.run([compiler, "-shared", compiled, "-o", linked], check=True)
        library = ctypes.CDLL(linked)
    library.is_limit.restype = ctypes.c_bool
    return library
