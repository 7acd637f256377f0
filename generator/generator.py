"""What every backend can be asked."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from dwgs.scene import InputError, Scene

if TYPE_CHECKING:
    from generator.conditions.conditions import Conditions


@dataclass(frozen=True)
class Capabilities:
    """What a backend needs and promises."""

    max_frames: int | None
    """Longest clip in one call, or None for any length."""
    size_multiple: int
    """Width and height of the images are multiples of this [px]."""
    device: str
    """Where it runs: ``cpu`` or ``cuda``."""
    needs_weights: bool
    """Whether files must be downloaded before it works."""
    deterministic: bool
    """Whether the same conditions and seed give the same bytes."""


class Generator(Protocol):
    """Fills the reactive masks of `Conditions`."""

    @property
    def name(self) -> str:
        """What `backend` knows it by."""
        ...

    @property
    def capabilities(self) -> Capabilities:
        """What it needs and promises."""
        ...

    def generate(
        self, conditions: "Conditions", seed: int, on_progress: Callable[[int, int], None] | None = None
    ) -> Scene:
        """The same cameras: new pixels inside the reactive masks, the recording's, bit for bit, around.

        Args:
            conditions: What to draw where.
            seed: Chooses among equally good answers.
            on_progress: Called with (frames done, frames in all).
        """
        ...


BACKENDS = ("composite", "asset")
"""Names that `backend` knows."""


def backend(name: str, asset: Path | None = None) -> Generator:
    """The generator of that name; it is imported only now.

    Args:
        name: ``composite`` or ``asset``.
        asset: Folder of the asset that the latter draws; by default it makes one of the vehicle's points.

    Raises:
        InputError: No backend is called so, or it lacks what it needs.
    """
    if asset is not None and name != "asset":
        raise InputError(f"'{name}' draws no asset folder: leave --asset out, or take --backend asset")
    if name == "composite":
        from generator.composite import CompositeGenerator

        return CompositeGenerator()
    if name == "asset":
        from dwgs.formats import asset_folder
        from generator.asset import AssetGenerator

        return AssetGenerator(None if asset is None else asset_folder.read(asset))
    raise InputError(f"no backend is called '{name}'; there is {', '.join(BACKENDS)} (they need no weights)")
