"""What a fit tells while it runs: bars print them, tests assert on them, a viewer may watch."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Preparing:
    """Work before the first step."""

    what: str
    """For people."""
    done: int
    total: int


@dataclass(frozen=True)
class Step:
    """One step of the optimiser is done."""

    step: int
    """Counted from 1."""
    steps: int
    """Length of the schedule."""
    loss: float


@dataclass(frozen=True)
class Evaluated:
    """Quality was measured."""

    step: int
    psnr: float
    """[dB]."""


@dataclass(frozen=True)
class Grown:
    """Gaussians were added or removed."""

    step: int
    count: int
    """How many there are now."""


Event = Preparing | Step | Evaluated | Grown
