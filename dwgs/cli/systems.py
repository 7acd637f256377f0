"""The systems that an evaluation compares: each turns a drive into the drive with the vehicle in it."""

from dataclasses import dataclass, fields, replace
from typing import Any

from dwgs.cli.backend import BackendChoice
from dwgs.scene import InputError

TRUTH = "ground-truth"
"""The true vehicle, where it can be rendered."""
DISTILLED = "-D"
"""Ends the name of a system whose vehicle is distilled and rendered with the reconstructed street."""
BACKENDS: dict[str, dict[str, Any]] = {
    "composite": {"backend": "composite", "asset": None},
    "asset": {"backend": "asset"},
    "vace": {"backend": "vace", "asset": None, "adapter": None},
    "streetcrafter": {"backend": "wan", "asset": None, "strategy": "autoregressive", "whole_frame": True},
    "wan": {"backend": "wan", "asset": None},
}
"""What each system but the truth sets of a `BackendChoice`; the rest is the user's: where weights are, how many steps.

HUGSIM's way is ``asset``, StreetCrafter's (points condition the whole frame, clip after clip) ``streetcrafter``,
DriveWeaver itself ``wan``, and DriveWeaver-D ``wan-D``.
"""
SYSTEMS = tuple(name + suffix for name in (TRUTH, *BACKENDS) for suffix in ("", DISTILLED))
"""Every row there can be."""


@dataclass(frozen=True)
class System:
    """One row of the table."""

    name: str
    """One of `SYSTEMS`."""
    choice: BackendChoice | None = None
    """What makes the pixels; None for the truth, or where it cannot work."""
    obstacle: str | None = None
    """Why it cannot work."""

    @staticmethod
    def of(name: str, given: BackendChoice) -> "System":
        """The system of that name, with what the user gave for all; `InputError` where there is none."""
        if name not in SYSTEMS:
            raise InputError(f"no system is called '{name}'; there are {', '.join(SYSTEMS)}")
        source = name.removesuffix(DISTILLED)
        if source == TRUTH:
            return System(name)
        settings = BACKENDS[source]
        known = {f.name for f in fields(BackendChoice)}
        if lacking := sorted(key for key in settings if settings[key] is not None and key not in known):
            return System(name, obstacle=f"no backend here knows {' and '.join(lacking)}")
        choice = replace(given, **{key: value for key, value in settings.items() if key in known})
        try:
            choice.open()
        except InputError as error:
            return System(name, obstacle=str(error))
        return System(name, choice)

    @property
    def source(self) -> str:
        """Whose video it is, or is distilled from."""
        return self.name.removesuffix(DISTILLED)

    @property
    def is_distilled(self) -> bool:
        """Whether its pixels are those of Gaussians."""
        return self.name.endswith(DISTILLED)
