"""What several verbs ask for, and how it becomes nouns."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from dwgs.scene import InputError, Insertion, Scene, Trajectory

WORKING_SIZE = "720x480"
"""Of the paper: a recording is fitted and edited at this size unless told otherwise."""

STREET_FRAMES = 193
"""Of the paper's long clips."""
STREET = "street"
"""Names the embedded street where a drive is asked for, and its own car where a vehicle is."""


@dataclass(frozen=True)
class Clip:
    """Which part of which drive."""

    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
    """Folder of a recorded drive (PandaSet's layout, or a Scene folder of ours), or 'street': the embedded
    one; 'street:1' is another."""
    camera: tuple[str, ...] = ()
    """Cameras to use, the main one first; by default the main one alone."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="FIRST-LAST")] = None
    """First and last frame, as in 30-78; by default all."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = None
    """Width x height [px] to work at; by default 720x480, or what a Scene folder of ours has."""

    def open(self) -> Scene:
        """The selected drive at its working size; pixels are read when they are needed."""
        from dwgs.datasets import resize_scene
        from dwgs.datasets.folder import SCENE_FILE

        whole = self.open_whole()
        scene = whole.select(list(self.camera) or [whole.main_camera], self._range())
        if self.is_street or (self.size is None and (Path(self.scene) / SCENE_FILE).exists()):
            return scene
        return resize_scene(scene, *self.width_height)

    def open_whole(self) -> Scene:
        """The drive as it was recorded: every camera, every frame."""
        from dwgs.datasets import open_scene

        return self.street().scene() if self.is_street else open_scene(Path(self.scene))

    def street(self):
        """The embedded street, as long and as large as asked."""
        frames = self._range()
        return _street(
            int(self.scene.partition(":")[2] or 0), frames.stop if frames else STREET_FRAMES, *self.width_height
        )

    @property
    def is_street(self) -> bool:
        """Whether the embedded street is meant."""
        return re.fullmatch(rf"{STREET}(:\d{{1,9}})?", self.scene) is not None

    @property
    def width_height(self) -> tuple[int, int]:
        """[px]."""
        match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", self.size or WORKING_SIZE)
        if not match or min(int(match[1]), int(match[2])) < 16:
            raise InputError(f"--size is width x height of at least 16 px each, as in 720x480; got '{self.size}'")
        return int(match[1]), int(match[2])

    def _range(self) -> range | None:
        if self.frames is None:
            return None
        match = re.fullmatch(r"(\d+)-(\d+)", self.frames)
        if not match or int(match[1]) > int(match[2]):
            raise InputError(f"--frames is first-last, as in 30-78; got '{self.frames}'")
        return range(int(match[1]), int(match[2]) + 1)


@dataclass(frozen=True)
class VehicleChoice:
    """Which vehicle to put in."""

    vehicle: Annotated[str, tyro.conf.arg(metavar="CAR")]
    """A mesh (glTF, OBJ, PLY, ...), a coloured point cloud (PLY), an asset folder, or the id of a recorded
    track; 'street' is the embedded street's own car."""
    unit: Annotated[Literal["m", "cm", "mm", "in", "ft"] | None, tyro.conf.arg(metavar="m|cm|mm|in|ft")] = None
    """Unit of the file, where it is not what was assumed."""
    forward: Annotated[Literal["x", "-x", "y", "-y", "z", "-z"] | None, tyro.conf.arg(metavar="x|-x|y|-y|z|-z")] = None
    """Axis of the file that points to the vehicle's front, where it is not what was assumed; write
    --forward=-y."""


@dataclass(frozen=True)
class Placement:
    """Where the vehicle drives."""

    trajectory: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File of times and poses (JSON or CSV); or use --ahead, --left and --speed."""
    ahead: Annotated[float | None, tyro.conf.arg(metavar="METRES")] = None
    """Start this far ahead of the recording car, along its path [m]."""
    left: Annotated[float, tyro.conf.arg(metavar="METRES")] = 0.0
    """Drive this far to the left of that path [m]; negative is right."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None
    """Speed along the path [m/s], 0 parks; by default it keeps the recording car's pace."""

    def drive(self, scene: Scene, size: np.ndarray) -> Trajectory:
        """The trajectory of a vehicle of that size through that scene."""
        from dwgs.scene.placement import place_ahead
        from dwgs.scene.trajectory_file import read_trajectory

        if self.trajectory is not None:
            return read_trajectory(self.trajectory, size)
        assert self.ahead is not None, "require() comes first"
        return place_ahead(scene, size, self.ahead, self.left, self.speed)

    def require(self) -> None:
        """Raise `InputError` unless exactly one way to drive is given."""
        if self.trajectory is not None and self.ahead is not None:
            raise InputError("a vehicle drives by --trajectory or by --ahead, not by both; leave one out")
        if not self.is_given:
            raise InputError("nothing says where the vehicle drives; give --trajectory FILE or --ahead METRES")

    @property
    def is_given(self) -> bool:
        """Whether the user said anything."""
        return self.trajectory is not None or self.ahead is not None


def author_insertion(
    clip: Clip, scene: Scene, choice: VehicleChoice, placement: Placement
) -> tuple[Insertion, list[str]]:
    """What the user wants inserted, and what was assumed on the way: one line each."""
    from generator.conditions import require_visible
    from generator.conditions.points import load_vehicle, points_of_track

    has_own_way = clip.is_street and choice.vehicle == STREET and not placement.is_given
    if not has_own_way:
        placement.require()
    notes = []
    path = Path(choice.vehicle)
    if choice.vehicle == STREET:
        vehicle, size = clip.street().vehicle
    elif path.exists() or path.suffix:
        vehicle, size, note = load_vehicle(path, choice.unit, choice.forward)
        notes.append(note)
    else:
        whole = clip.open_whole()  # cameras that are not edited saw the vehicle, too
        track = whole.track(choice.vehicle)
        vehicle, size = points_of_track(whole, track)
        notes.append(f"{choice.vehicle}: recorded {track.category.lower()}, {len(vehicle.points):,} LiDAR points")
    trajectory = clip.street().insertion().trajectory if has_own_way else placement.drive(scene, size)
    insertion = Insertion(vehicle, size, trajectory)
    require_visible(scene, insertion)
    return insertion, notes + conflict_notes(scene, size, trajectory)


def conflict_notes(scene: Scene, size: np.ndarray, trajectory: Trajectory) -> list[str]:
    """One line for each recorded vehicle that the inserted box runs into."""
    from dwgs.scene.placement import conflicts

    return [
        f"the inserted vehicle overlaps recorded track {id} in frames {first}-{last}; --left, --ahead move it"
        for id, first, last in conflicts(scene, size, trajectory)
    ]


@cache
def _street(seed: int, frames: int, width: int, height: int):
    from dwgs.street import build_street

    return build_street(seed, frames, width, height)


Flat = tyro.conf.arg(name="")
"""Options of a group stand beside those of the verb."""
ClipOptions = Annotated[Clip, Flat]
VehicleOptions = Annotated[VehicleChoice, Flat]
PlacementOptions = Annotated[Placement, Flat]
