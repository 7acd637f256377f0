"""The systems that an evaluation compares: each turns a drive into the drive with the vehicle in it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from dwgs.cli.backend import BackendChoice
from dwgs.cli.train import ADAPTER, SETTINGS, TRAINED_BACKBONE
from dwgs.scene import InputError

TRUTH = "ground-truth"
"""The true vehicle, where it can be rendered."""
DISTILLED = "-D"
"""Ends the name of a system whose vehicle is distilled and rendered with the reconstructed street."""


@dataclass(frozen=True)
class Recipe:
    """What makes a system; the rest is the user's: where weights are, how many steps."""

    choice: Mapping[str, Any]
    """What it sets of a `BackendChoice`."""
    taught: Mapping[str, Any] = field(default_factory=dict)
    """What `dwgs train` was told to make its weights; where there is anything, they are its own."""


ASIS = {"trains": "adapter", "strategy": "global-to-local", "points": "discs", "whole_frame": False}
"""What `dwgs train` is told of these unless something else is said: DriveWeaver."""
RECIPES = {
    "composite": Recipe({"backend": "composite"}),
    "asset": Recipe({"backend": "asset"}),
    "vace": Recipe({"backend": "vace", "adapter": None}),
    "streetcrafter": Recipe(
        {"backend": "wan", "strategy": "autoregressive", "whole_frame": True},
        {"strategy": "autoregressive", "whole_frame": True},
    ),
    "wan": Recipe({"backend": "wan"}),
    "wan-finetuned": Recipe({"backend": "wan"}, {"trains": "all"}),
    "wan-pixels": Recipe({"backend": "wan"}, {"points": "pixels"}),
    "wan-autoregressive": Recipe({"backend": "wan", "strategy": "autoregressive"}, {"strategy": "autoregressive"}),
}
"""Every system but the truth.

HUGSIM's way is ``asset``, StreetCrafter's (points condition the whole frame, clip after clip) ``streetcrafter``,
DriveWeaver itself ``wan``, and DriveWeaver-D ``wan-D``. The last three are the paper's ablations: the backbone learns
instead of an adapter, points are pixels instead of discs, and clips follow each other.
"""
SYSTEMS = tuple(name + suffix for name in (TRUTH, *RECIPES) for suffix in ("", DISTILLED))
"""Every row there can be."""
TAUGHT = tuple(name for name, recipe in RECIPES.items() if recipe.choice["backend"] == "wan")
"""Systems that take weights of `dwgs train`; what is distilled from their videos takes none of its own."""


@dataclass(frozen=True)
class System:
    """One row of the table."""

    name: str
    """One of `SYSTEMS`."""
    choice: BackendChoice | None = None
    """What makes the pixels; None for the truth, or where it cannot work."""
    points: Literal["discs", "pixels"] = "discs"
    """How the points of its conditions are drawn."""
    obstacle: str | None = None
    """Why it cannot work."""

    @staticmethod
    def of(name: str, given: BackendChoice, trained: Mapping[str, Path]) -> "System":
        """The system of that name.

        Args:
            name: One of `SYSTEMS`.
            given: What the user said for all.
            trained: Folders of `dwgs train` by the name of the system whose weights they hold.

        Raises:
            InputError: There is none of that name, or one of ``trained`` takes no such weights.
        """
        if name not in SYSTEMS:
            raise InputError(f"no system is called '{name}'; there are {', '.join(SYSTEMS)}")
        if strange := [key for key in trained if key not in TAUGHT]:
            raise InputError(f"--trained is for {', '.join(TAUGHT)}, not for '{strange[0]}'")
        source = name.removesuffix(DISTILLED)
        if source == TRUTH:
            return System(name)
        recipe = RECIPES[source]
        asset = given.asset if recipe.choice["backend"] == "asset" else None
        choice = replace(given, **{"asset": asset, "whole_frame": False, **recipe.choice})
        try:
            if source in trained:
                choice = _with_weights(choice, recipe, trained[source])
            elif recipe.taught:
                raise InputError(f"it has weights of its own: give --trained {source} DIR, from {_training(recipe)}")
            choice.open()
        except InputError as error:
            return System(name, obstacle=str(error))
        return System(name, choice, recipe.taught.get("points", "discs"))

    @property
    def source(self) -> str:
        """Whose video it is, or is distilled from."""
        return self.name.removesuffix(DISTILLED)

    @property
    def is_distilled(self) -> bool:
        """Whether its pixels are those of Gaussians."""
        return self.name.endswith(DISTILLED)


def _with_weights(choice: BackendChoice, recipe: Recipe, folder: Path) -> BackendChoice:
    """The choice with the weights that a training left; `InputError` where it was taught something else."""
    try:
        said = json.loads((folder / SETTINGS).read_text(encoding="utf-8"))["settings"]
        taught = {key: said[key] for key in ASIS}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"'{folder}' is no finished training; give what {_training(recipe)} left") from None
    for key, value in {**ASIS, **recipe.taught}.items():
        if taught[key] != value:
            raise InputError(f"'{folder}' was taught with {key} {taught[key]}; give what {_training(recipe)} left")
    backbone = folder / TRAINED_BACKBONE if taught["trains"] == "all" else choice.backbone
    return replace(choice, backbone=backbone, adapter=folder / ADAPTER)


def _training(recipe: Recipe) -> str:
    """The command that makes a system's weights."""
    options = [
        f"--{key.replace('_', '-')}" + ("" if value is True else f" {value}") for key, value in recipe.taught.items()
    ]
    return " ".join(["`dwgs train", *options]) + "`"
