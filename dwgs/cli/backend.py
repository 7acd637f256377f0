"""What makes the pixels, as a person chooses it."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from dwgs.cli.stage import fingerprint

if TYPE_CHECKING:
    from generator import Generator


@dataclass(frozen=True)
class BackendChoice:
    """Which backend makes the pixels, and how."""

    backend: str = "composite"
    """composite (the vehicle in the street's light), or asset (Gaussians drawn as they are, with a shadow
    beneath); neither needs weights."""
    asset: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Asset folder that the backend asset draws; by default one is made of the vehicle's points."""

    def open(self) -> "Generator":
        """The backend; what can be wrong with its files is found now."""
        from generator import backend

        return backend(self.backend, self.asset)

    def key(self) -> dict[str, Any]:
        """Everything that the pixels depend on."""
        folders = [fingerprint(folder) for folder in (self.asset,) if folder is not None and folder.exists()]
        return {**asdict(self), "folders": folders}


BackendOptions = Annotated[BackendChoice, tyro.conf.arg(name="")]
"""They stand beside those of the verb."""
