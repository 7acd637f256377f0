"""A stage: runs when its inputs have changed, and leaves a record of how it came to be."""

import contextlib
import ctypes
import gc
import hashlib
import json
import platform
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import dwgs
from dwgs.cli.progress import Bar, bar, say
from dwgs.files import new_folder

RECORD = "run.json"
FIT = "fit.pt"
"""Among the finished parts of a stage: how far its fit is."""


@dataclass(frozen=True)
class StageRecord:
    """How a stage went."""

    key: str
    """Hash of everything the stage depends on."""
    seconds: float
    peak_memory_mib: float
    """Most resident memory of the process while the stage ran."""
    report: dict[str, Any]
    """What the stage measured of itself."""
    skipped: bool = False
    """Whether the result of an earlier run was taken."""


def run_stage(
    folder: Path, title: str, inputs: dict[str, Any], make: Callable[[Path, Bar], dict[str, Any]]
) -> StageRecord:
    """Fill ``folder`` by ``make(draft, bar)`` unless it was made of the same inputs before.

    ``inputs`` are JSON values: settings, and the keys or fingerprints of what is read.
    """
    key = stage_key(title, inputs)
    former = read_record(folder / RECORD)
    if former is not None and former.key == key:
        return kept(former, title)
    with new_folder(folder) as draft:
        record = measured(key, title, lambda progress: make(draft, progress))
        write_record(record, draft / RECORD, inputs=inputs, versions=versions())
    return record


@contextlib.contextmanager
def unfinished(folder: Path, key: str) -> Iterator[Path]:
    """A path beside ``folder`` for finished parts of a stage of that key.

    They are there again when the stage is run again after it failed or was killed; they are gone when it has ended
    well, and when it is run with another key.
    """
    place = folder.parent / f".{folder.name}.parts"
    for other in place.glob("*"):
        if other.name != key:
            shutil.rmtree(other)
    yield place / key
    shutil.rmtree(place, ignore_errors=True)


def stage_key(title: str, inputs: dict[str, Any]) -> str:
    """Hash of a stage's name, its inputs and this version of the program."""
    text = json.dumps([dwgs.__version__, title, inputs], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def measured(key: str, title: str, work: Callable[[Bar], dict[str, Any]]) -> StageRecord:
    """Do the work under a bar, and note how long and how large it was."""
    start = time.perf_counter()
    with PeakMemory() as peak, bar(title) as progress:
        report = work(progress)
    _give_memory_back()
    return StageRecord(key, round(time.perf_counter() - start, 2), round(peak.mib, 1), report)


def kept(former: StageRecord, title: str) -> StageRecord:
    """The result of an earlier run, taken as it is."""
    say(f"{title:<12} unchanged, kept")
    return replace(former, skipped=True)


def read_record(path: Path) -> StageRecord | None:
    """The record of an earlier run, or None where there is none that can be read."""
    try:
        record = json.loads(path.read_text())
        return StageRecord(record["key"], record["seconds"], record["peak_memory_mib"], record["report"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def write_record(record: StageRecord, path: Path, **more: Any) -> None:
    """Keep a record for the next run, and whatever else explains the result."""
    path.write_text(json.dumps({**asdict(record), **more}, indent=2, default=str))


def versions() -> dict[str, str]:
    """Of what took part."""
    found = {"python": platform.python_version()}
    for name in ("dwgs", "torch", "warp-lang", "numpy", "diffusers"):
        with contextlib.suppress(PackageNotFoundError):  # the last comes with an extra
            found[name] = version(name)
    return found


def fingerprint(path: Path) -> list:
    """Tells one state of a file or folder from another: names, sizes and times of change of all its files."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    stats = [(file, file.stat()) for file in files]
    return [[str(path.resolve())], *([str(f.relative_to(path)), s.st_size, s.st_mtime_ns] for f, s in stats)]


class PeakMemory:
    """Watches the resident memory of this process while a block runs."""

    def __init__(self) -> None:
        self.mib = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> "PeakMemory":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        while True:
            self.mib = max(self.mib, _resident_mib())
            if self._stop.wait(0.05):
                return


def _give_memory_back() -> None:
    """Return what is free to the system: glibc keeps a stage's middle-sized arrays for the next one otherwise."""
    gc.collect()
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):  # not every Linux has glibc
            ctypes.CDLL("libc.so.6").malloc_trim(0)


def _resident_mib() -> float:
    """Resident memory now; where the system has no /proc, the most there ever was."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # macOS counts bytes
    return pages * 4096 / 2**20
