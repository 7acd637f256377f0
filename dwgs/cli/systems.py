"""The systems that an evaluation compares: each turns a drive into the drive with the vehicle in it."""

from dataclasses import dataclass

from dwgs.scene import InputError

TRUTH = "ground-truth"
"""The true vehicle where it can be rendered, the recording where not."""
DISTILLED = "-D"
"""Ends the name of a system whose vehicle is distilled and rendered with the reconstructed street."""
SYSTEMS = {
    TRUTH: None,
    "composite": "composite",
    "asset": "asset",
    "vace": "vace",
    "wan": "wan",
}
"""Name to the backend that makes the pixels."""


@dataclass(frozen=True)
class System:
    """One row of the table."""

    name: str

    @property
    def source(self) -> str:
        """Whose video it is, or is distilled from."""
        return self.name.removesuffix(DISTILLED)

    @property
    def is_distilled(self) -> bool:
        """Whether its pixels are those of Gaussians."""
        return self.name.endswith(DISTILLED)

    @property
    def backend(self) -> str | None:
        """What makes the pixels; None for the truth."""
        return SYSTEMS[self.source]

    def obstacle(self) -> str | None:
        """Why it cannot run here, or None where it can."""
        from generator import backend

        if self.backend is None:
            return None
        try:
            backend(self.backend)
        except InputError as error:
            return str(error)
        return None


ALL = tuple(name + suffix for name in SYSTEMS for suffix in ("", DISTILLED))
"""Every row there can be."""


def read_systems(names: tuple[str, ...]) -> list[System]:
    """The systems of those names; `InputError` names the first that there is not."""
    for name in names:
        if name not in ALL:
            raise InputError(f"no system is called '{name}'; there are {', '.join(ALL)}")
    return [System(name) for name in dict.fromkeys(names)]
