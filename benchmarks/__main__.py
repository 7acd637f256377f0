"""Run one workload, print its metrics, write them as JSON where asked."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

import dwgs  # noqa: F401  (first of all: it settles how torch's threads wait)
from benchmarks.metric import Metric, machine, write

SplatScene = Literal["car5k", "car20k", "car100k", "full200k", "street1m"]
Drive = Literal["street", "near", "far", "overtaking", "parked"]


@dataclass(frozen=True)
class Workload(ABC):
    """What a run of any workload can be told."""

    json: Path | None = None
    """Write the metrics here as well."""

    @abstractmethod
    def measure(self) -> list[Metric]:
        """Do the work."""


@dataclass(frozen=True)
class Oracle(Workload):
    """What distillation alone loses: the embedded street with the true vehicle in it."""

    frames: int = 193
    """Length of the clip."""
    steps: int = 1200
    """Of each distillation."""

    def measure(self) -> list[Metric]:
        """Fit, hold against the truth."""
        from benchmarks.workloads import oracle

        return oracle.run(self.frames, self.steps)


@dataclass(frozen=True)
class Splat(Workload):
    """Time and memory of the splatter, beside a plain C++ loop and torch, and on a GPU beside gsplat."""

    scenes: tuple[SplatScene, ...] = ("car5k", "car20k", "car100k", "full200k", "street1m")
    """What is drawn."""
    torch_scenes: tuple[SplatScene, ...] = ("car20k",)
    """Of these, where torch is measured too: it is slow."""
    devices: tuple[Literal["cpu", "cuda"], ...] = ("cpu", "cuda")
    """Where; without a GPU the second is left out."""
    repeats: int = 9
    """Rounds that count."""

    def measure(self) -> list[Metric]:
        """Render, forward and backward."""
        from benchmarks.workloads import splat

        return splat.run(self.scenes, self.torch_scenes, self.devices, self.repeats)


@dataclass(frozen=True)
class Distill(Workload):
    """What a distillation reaches in the seconds it is given, and what the rest of the field needs for that."""

    frames: int = 193
    """Length of the clip."""
    drives: tuple[Drive, ...] = ("street",)
    """Ways of the vehicle through the street."""
    seconds: tuple[float, ...] = (10, 25, 60)
    """The times, everything but judging included."""
    reference_steps: int = 0
    """Of a fit that counts as converged, and is kept beside the benchmark; 0: what is kept there."""
    without_shadow: float = 0
    """Seconds given to one more fit, and to one that may not explain the vehicle's shadow; 0 leaves both out."""
    backgrounds: tuple[int, ...] = (100_000, 1_000_000, 5_000_000)
    """Gaussians behind the vehicle whose steps are timed; none: leave that out."""
    rivals: float = 0
    """Seconds after which a rival is given up; 0 leaves them out."""
    rivals_against: float = 25
    """Seconds of ours: what it reaches then, rivals have to reach."""
    rivals_steps: int = 30_000
    """Length of their schedule; what is shorter than the field's own scales all of it."""
    pandaset: Path | None = None
    """Folder of PandaSet's sequence 002, whose overtaking car is distilled."""
    vehicle: Path | None = None
    """A file whose vehicle is put into that sequence, and distilled from what the default backend paints."""
    pandaset_seconds: tuple[float, ...] = (10, 30)
    """The times for these two."""
    pose_noise: int = 0
    """So many times 5 cm and half a degree of noise are put on every pose of each drive, and what is left is told."""
    pose_steps: int = 1200
    """Of the fits before that noise."""

    def measure(self) -> list[Metric]:
        """Fit, again and again."""
        from rich.progress import Progress

        from benchmarks.workloads import distill, distill_pandaset, distill_poses, distill_rivals, distill_step
        from dwgs.reconstruct import ReconstructConfig
        from dwgs.street import build_street

        street, metrics = build_street(frames=self.frames), []
        with Progress() as progress:
            if self.drives and self.seconds:
                plan = distill.Plan(self.drives, self.seconds, self.reference_steps, self.without_shadow)
                metrics += distill.run(street, plan, progress)
            if self.pose_noise:
                metrics += distill_poses.run(street, self.drives, self.pose_steps, self.pose_noise, progress)
            if self.backgrounds:
                metrics += distill_step.run(street, self.backgrounds, progress)
            if self.rivals:
                race = distill_rivals.Race(
                    self.rivals_against, self.rivals, self.rivals_steps, ReconstructConfig.draft()
                )
                metrics += distill_rivals.run(street, race, progress)
            if self.pandaset:
                metrics += distill_pandaset.run(
                    self.pandaset, self.vehicle, self.pandaset_seconds, ReconstructConfig(), progress
                )
        return metrics


@dataclass(frozen=True)
class Generator(Workload):
    """Whether a toy PointAdapter learns from embedded streets, on a CPU."""

    steps: int = 600
    """Of its training."""
    streets: int = 3
    """That teach."""

    def measure(self) -> list[Metric]:
        """Train, generate, compare."""
        from benchmarks.workloads import generator

        return generator.run(self.steps, self.streets)


@dataclass(frozen=True)
class Run:
    """Measure one workload."""

    workload: (
        Annotated[Oracle, tyro.conf.subcommand("oracle")]
        | Annotated[Splat, tyro.conf.subcommand("splat")]
        | Annotated[Distill, tyro.conf.subcommand("distill")]
        | Annotated[Generator, tyro.conf.subcommand("generator")]
    )


def main() -> None:
    """Measure and print."""
    config = (tyro.conf.OmitArgPrefixes,)
    verb = tyro.extras.subcommand_cli_from_dict({"run": Run}, prog="python -m benchmarks", config=config)
    metrics = verb.workload.measure()
    for metric in metrics:
        spread = "" if metric.spread is None else f"+- {metric.spread:.4g}"
        print(f"{metric.key:<44} {metric.value:14.4f} {metric.unit:<2} {spread}".rstrip())
    print(", ".join(f"{name} {value}" for name, value in machine().items()))
    if verb.workload.json:
        write(metrics, verb.workload.json)


if __name__ == "__main__":
    main()
