"""Run one workload, print its metrics, write them as JSON where asked."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal

import tyro

from benchmarks.metric import machine, write


@dataclass(frozen=True)
class Run:
    """Measure one workload."""

    workload: tyro.conf.Positional[Literal["oracle"]]
    """File in benchmarks/workloads."""
    json: Path | None = None
    """Write the metrics here as well."""
    frames: int = 193
    """Length of the clip."""


def main() -> None:
    """Measure and print."""
    verb = tyro.extras.subcommand_cli_from_dict({"run": Run}, prog="python -m benchmarks")
    metrics = import_module(f"benchmarks.workloads.{verb.workload}").run(verb.frames)
    for metric in metrics:
        print(f"{metric.key:<44} {metric.value:12.4f} {metric.unit}")
    print(", ".join(f"{name} {value}" for name, value in machine().items()))
    if verb.json:
        write(metrics, verb.json)


main()
