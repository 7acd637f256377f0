"""dwgs distill: the vehicle as Gaussians."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dwgs.cli.options import ClipOptions
from dwgs.cli.progress import Bar, decibels, say
from dwgs.cli.reconstruct import TRAJECTORY_FILE, clip_key
from dwgs.cli.render import read_driven
from dwgs.cli.stage import FIT, StageRecord, fingerprint, run_stage, stage_key, unfinished
from dwgs.scene import InputError, Insertion, Scene

if TYPE_CHECKING:
    from dwgs.distill import DistillConfig


@dataclass(frozen=True)
class Distill:
    """Fit a vehicle's Gaussians to a video, against a frozen background: inserted, or recorded (--track)."""

    clip: ClipOptions
    background: Path
    """Folder from `dwgs reconstruct`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the asset."""
    insertion: Path | None = None
    """Folder of the insertion (inside a conditions folder), for an edited Scene."""
    track: str | None = None
    """Id of a recorded vehicle, or how it begins."""
    traffic: tuple[Path, ...] = ()
    """Asset folders of other vehicles, each where it drives in the scene (distilled before, or traffic/* from
    `dwgs reconstruct --joint`): frozen like the background, so that pixels which show them teach, too. The
    vehicle itself may be among them."""
    steps: int | None = None
    """Steps of the optimiser; by default what suits the video."""
    seconds: float | None = None
    """Instead: how long preparing and fitting may take; the schedule is made for that."""
    seed: int = 0
    """Of everything random."""

    def config(self) -> "DistillConfig":
        """How it is fitted."""
        if self.steps is not None and self.seconds is not None:
            raise InputError("a schedule is as long as --steps or as --seconds say: give one of them")
        return distill_config(self.steps, self.seed, self.seconds)

    def run(self) -> None:
        """Leave an asset folder."""
        from dwgs.distill import FrozenBackground, others
        from dwgs.formats import background_folder

        config = self.config()
        scene = self.clip.open()
        if self.track is not None and self.insertion is None:
            insertion = insertion_of_track(self.clip.open_whole(), self.track)
        elif self.insertion is not None and self.track is None:
            from generator.conditions import read_insertion

            insertion = read_insertion(self.insertion)
        else:
            raise InputError("distill one vehicle: --track ID for a recorded one, --insertion DIR for an edited Scene")
        background = background_folder.read(self.background)
        traffic = others([read_driven(folder) for folder in self.traffic], insertion)
        source = {
            "clip": clip_key(self.clip),
            "background": background_folder.fingerprint(self.background),
            "insertion": self.track if self.insertion is None else fingerprint(self.insertion),
            "traffic": [fingerprint(folder) for folder in self.traffic],
        }
        frozen = FrozenBackground(background, scene.all_frames(), traffic)
        record = distill_stage(scene, frozen, insertion, source, self.out, config)
        report = record.report
        say(f"held-out ROI PSNR {decibels(report['psnr_roi_heldout'])}, {report['gaussians']:,} Gaussians")
        say(
            f"next: dwgs render {self.clip.scene} --background {self.background} --asset {self.out} "
            "--move 0 3 0 -o moved.mp4"
        )


def distill_config(steps: int | None, seed: int, seconds: float | None = None) -> "DistillConfig":
    """Of what may be left out on the command line."""
    from dwgs.distill import DistillConfig

    default = DistillConfig(seed=seed, seconds=seconds)
    return default if steps is None else replace(default, steps=steps)


def insertion_of_track(scene: Scene, id: str) -> Insertion:
    """A recorded vehicle as if it had been inserted where it drove."""
    from generator.conditions.points import points_of_track

    track = scene.track(id)
    if not track.is_vehicle:
        raise InputError(f"only vehicles are rigid enough to distil, track {track.id} is a {track.category}")
    vehicle, size = points_of_track(scene, track)
    return Insertion(vehicle, size, track.trajectory, track.category)


def distill_stage(
    scene: Scene, background, insertion: Insertion, source: dict, folder: Path, config: "DistillConfig"
) -> StageRecord:
    """Fit the asset of ``insertion`` into ``folder``; what was killed meanwhile goes on."""
    from dwgs.distill import distill
    from dwgs.optimize import Checkpoint

    inputs = {"source": source, "config": asdict(config)}

    def make(draft: Path, progress: Bar) -> dict:
        from dwgs.formats import asset_folder
        from dwgs.scene.trajectory_file import write_trajectory

        distilled = progress.follow(distill(scene, background, insertion, config, Checkpoint(parts / FIT)))
        asset_folder.write(distilled.asset, draft)
        write_trajectory(distilled.trajectory, draft / TRAJECTORY_FILE)
        return distilled.report

    with unfinished(folder, stage_key("distill", inputs)) as parts:
        return run_stage(folder, "distill", inputs, make)
