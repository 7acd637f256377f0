"""What every backend can be asked."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from dwgs.scene import InputError, Scene

if TYPE_CHECKING:
    from generator.conditions.conditions import Conditions
    from generator.wan.settings import WanSettings


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

    def check(self, scene: Scene) -> list[str]:
        """What a person should know before it works on such a drive, a line each.

        Raises:
            InputError: It cannot work on such images here, and why.
        """
        ...

    def generate(
        self, conditions: "Conditions", seed: int, on_progress: Callable[[int, int], None] | None = None
    ) -> Scene:
        """The same cameras: new pixels inside the reactive masks, the recording's, bit for bit, around.

        Args:
            conditions: What to draw where.
            seed: Chooses among equally good answers.
            on_progress: Called with (work done, work in all), in frames or in steps.
        """
        ...


BACKENDS = ("composite", "asset", "wan", "vace")
"""Names that `backend` knows."""


def backend(
    name: str, settings: "WanSettings | None" = None, parts: Path | None = None, asset: Path | None = None
) -> Generator:
    """The generator of that name; it is imported only now.

    Args:
        name: ``composite`` and ``asset`` need no weights and run anywhere, ``wan`` is the paper's, ``vace`` what it
            builds on.
        settings: Of the latter two: where their weights are, and how they work.
        parts: Folder where the latter two keep finished clips, so that a run that was killed goes on.
        asset: Folder of the asset that ``asset`` draws; by default it makes one of the vehicle's points.

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
    if name not in BACKENDS:
        raise InputError(f"no backend is called '{name}'; there is {', '.join(BACKENDS)}")
    if settings is None:
        raise InputError(f"'{name}' needs weights: give --backbone DIR, or take composite, which needs none")
    if name == "wan" and settings.adapter is None:
        raise InputError("'wan' needs a PointAdapter: give --adapter DIR, or take vace, which works without")
    if name == "vace" and settings.adapter is not None:
        raise InputError("'vace' takes no PointAdapter: leave --adapter out, or take wan")
    if name == "vace" and settings.whole_frame:
        raise InputError("'vace' sees no points to paint whole frames by: leave --whole-frame out, or take wan")
    if find_spec("diffusers") is None:
        raise InputError(f"'{name}' needs more packages: pip install 'dwgs[wan]'; composite needs none of them")
    from generator.wan.wan import WanGenerator

    return WanGenerator(settings, parts)
