"""dwgs condition: what a generator is told."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dwgs.cli.options import ClipOptions, PlacementOptions, VehicleChoice, VehicleOptions, author_insertion
from dwgs.cli.progress import Bar, say
from dwgs.cli.reconstruct import clip_key
from dwgs.cli.stage import StageRecord, fingerprint, run_stage
from dwgs.scene import Insertion, Scene


@dataclass(frozen=True)
class Condition:
    """Draw what a generator is told: point images, point masks, reactive masks."""

    clip: ClipOptions
    choice: VehicleOptions
    placement: PlacementOptions
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the conditions."""
    points: Literal["discs", "pixels"] = "discs"
    """How the vehicle's points are drawn; pixels is what `dwgs train --points pixels` teaches."""

    def run(self) -> None:
        """Leave a conditions folder."""
        scene = self.clip.open()
        insertion, notes = author_insertion(self.clip, scene, self.choice, self.placement)
        for note in notes:
            say(note)
        key = insertion_key(self.clip, self.choice, self.placement)
        condition_stage(scene, insertion, key, self.out, self.points)
        say(f"next: dwgs generate {self.clip.scene} --conditions {self.out} -o edited/")


def insertion_key(clip, choice: VehicleChoice, placement) -> dict:
    """Everything that an insertion depends on."""
    files = [vehicle_fingerprint(Path(choice.vehicle))]
    if placement.trajectory is not None and placement.trajectory.exists():
        files.append(fingerprint(placement.trajectory))
    return {"clip": clip_key(clip), "choice": asdict(choice), "placement": asdict(placement), "files": files}


def vehicle_fingerprint(path: Path) -> list:
    """Of a vehicle file and of the materials and textures that lie beside it."""
    if not path.exists():
        return [str(path)]
    if path.suffix.lower() in (".obj", ".gltf"):
        companions = {".mtl", ".png", ".jpg", ".jpeg", ".bin"}
        files = [path, *sorted(p for p in path.parent.iterdir() if p.suffix.lower() in companions)]
        return [fingerprint(p) for p in files]
    return fingerprint(path)


def condition_stage(
    scene: Scene, insertion: Insertion, source: dict, folder: Path, points: Literal["discs", "pixels"] = "discs"
) -> StageRecord:
    """Draw the conditions of ``insertion`` into ``folder``."""

    def make(draft: Path, progress: Bar) -> dict:
        from generator.conditions import make_conditions, write

        conditions = make_conditions(scene, insertion, progress.count, points=points)
        write(conditions, draft)
        return {"points": len(insertion.vehicle.points), "size": [round(float(s), 3) for s in insertion.size]}

    return run_stage(folder, "condition", {**source, "points": points}, make)
