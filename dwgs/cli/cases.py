"""The drives of an evaluation, each with the vehicle that is put into it."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from dwgs.cli.options import STREET, Clip, Placement, VehicleChoice
from dwgs.scene import InputError


@dataclass(frozen=True)
class Case:
    """One drive and one vehicle."""

    name: str
    """Of its folder."""
    clip: Clip
    choice: VehicleChoice
    placement: Placement

    @property
    def knows_truth(self) -> bool:
        """Whether the true vehicle can be rendered: the street's own, in the street."""
        return self.clip.is_street and self.choice.vehicle == STREET


def read_cases(names: Sequence[str], defaults: Clip) -> list[Case]:
    """The cases that ``names`` stand for: streets ('street:1'), or JSON files that list drives.

    A file holds a list of objects with the options of `dwgs insert` as keys: "scene", "vehicle", and as needed
    "ahead", "left", "speed", "trajectory", "frames", "size", "camera", "unit", "forward". What a case does not say
    of frames and size is taken from ``defaults``. Relative paths start at the file. Raises `InputError`.
    """
    cases: list[Case] = []
    for name in names:
        clip = replace(defaults, scene=name)
        if clip.is_street:
            cases.append(Case(name.replace(":", "-"), clip, VehicleChoice(STREET), Placement()))
        elif name.endswith(".json"):
            cases += [_case(entry, Path(name), number, defaults) for number, entry in enumerate(_entries(Path(name)))]
        else:
            raise InputError(
                f"'{name}' says a drive but not what is put into it; list drives with their vehicles in a .json file, "
                'as in [{"scene": "drive/", "vehicle": "car.glb", "ahead": 14, "left": 3.3}]'
            )
    twice = {case.name for case in cases if sum(other.name == case.name for other in cases) > 1}
    if twice or not cases:
        named = ", ".join(sorted(twice)) or "none"
        raise InputError(f"an evaluation is of at least one case, and of each once; named twice: {named}")
    return cases


def _entries(path: Path) -> list[dict[str, Any]]:
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"there is no list of cases '{path}'") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"'{path}' is not JSON ({error}); write a list of objects") from None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(f"'{path}' is a list of objects, one for each drive")
    return entries


def _case(entry: dict[str, Any], path: Path, number: int, defaults: Clip) -> Case:
    where = f"case {number} of '{path}'"
    known = {f.name for noun in (Clip, VehicleChoice, Placement) for f in fields(noun)}
    strange = sorted(set(entry) - known)
    if strange:
        raise InputError(f"{where} has options of dwgs insert as keys, '{strange[0]}' is none")
    if not {"scene", "vehicle"} <= set(entry):
        raise InputError(f"{where} lacks its scene or its vehicle")
    texts = {key: str(entry[key]) for key in ("scene", "vehicle", "frames", "size", "unit", "forward") if key in entry}
    try:
        numbers = {key: float(entry[key]) for key in ("ahead", "left", "speed") if key in entry}
    except (TypeError, ValueError):
        raise InputError(f"{where}: ahead, left and speed are numbers") from None
    scene, vehicle = (_beside(path, texts.pop(key)) for key in ("scene", "vehicle"))
    choice = {key: texts.pop(key) for key in ("unit", "forward") if key in texts}
    cameras = entry.get("camera", defaults.camera)
    cameras = (cameras,) if isinstance(cameras, str) else tuple(map(str, cameras))
    trajectory = Path(_beside(path, str(entry["trajectory"]))) if "trajectory" in entry else None
    return Case(
        f"{path.stem}-{number}",
        replace(defaults, scene=scene, camera=cameras, **texts),
        VehicleChoice(vehicle, **choice),  # pyright: ignore[reportArgumentType]
        Placement(trajectory, **numbers),
    )


def _beside(path: Path, name: str) -> str:
    """A name that is a path beside the file, as that path; any other as it is."""
    return str(path.parent / name) if (path.parent / name).exists() else name
