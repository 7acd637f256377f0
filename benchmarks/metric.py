"""One measured number, and where it was measured."""

import json
import os
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import torch


@dataclass(frozen=True)
class Metric:
    """A value under a dotted key."""

    key: str
    value: float
    unit: str
    spread: float | None = None
    """Interquartile range over repeats, where there are any."""


def machine() -> dict:
    """What the numbers depend on besides the code."""
    packages = ("torch", "warp-lang", "numpy")
    return {
        "cpu": _cpu_name(),
        "gpu": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def _cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def write(metrics: list[Metric], path: Path) -> None:
    """Write the metrics and the machine as JSON."""
    path.write_text(json.dumps({"metrics": [asdict(m) for m in metrics], "machine": machine()}, indent=2))
