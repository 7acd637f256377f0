"""dwgs reconstruct: the street without its traffic, or with all of it."""

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from dwgs.cli.options import ClipOptions
from dwgs.cli.progress import Bar, decibels, say
from dwgs.cli.stage import FIT, StageRecord, fingerprint, run_stage, stage_key, unfinished
from dwgs.scene import InputError, Insertion, Scene

if TYPE_CHECKING:
    from dwgs.reconstruct import ReconstructConfig

TRAFFIC = "traffic"
"""Folder in that of the background with an asset for each track that moves."""
TRAJECTORY_FILE = "trajectory.json"
"""Beside an asset: where it drove in the scene it comes from."""


@dataclass(frozen=True)
class Reconstruct:
    """Reconstruct the static street as Gaussians, without the traffic; then it is frozen. Or all of it (--joint)."""

    clip: ClipOptions
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the background."""
    joint: bool = False
    """All that moves as well, each vehicle an asset in traffic/: every pixel is explained, and scored in
    report.json and worst.png."""
    insertion: Path | None = None
    """Folder of the insertion (inside a conditions folder), if the drive is an edited one and --joint."""
    draft: bool = False
    """Half the Gaussians and a tenth of the steps."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        """Leave a background folder."""
        scene = self.clip.open()
        if self.joint:
            record = self.run_joint(scene)
            report = record.report
            say(f"whole images, training PSNR {decibels(report['psnr_train'])}, SSIM {report['ssim_train']:.4f}")
            if report["actors"]:
                say(f"street {report['psnr_static_train']:.2f} dB, traffic {report['psnr_actors_train']:.2f} dB")
            say(f"held-out PSNR {decibels(report['psnr_heldout'])}, {report['gaussians']:,} Gaussians")
            say(f"look at {self.out / 'worst.png'}: frames recorded, rendered, and how they differ")
            return
        if self.insertion is not None:
            raise InputError("an inserted vehicle is reconstructed with --joint only; add it, or leave --insertion out")
        record = reconstruct_stage(scene, self.clip_key(), self.out, self.draft, self.seed)
        say(f"held-out PSNR {decibels(record.report['psnr_heldout'])}, {record.report['gaussians']:,} Gaussians")
        say(f"next: dwgs distill {self.clip.scene} --track ID --background {self.out} -o asset/")

    def run_joint(self, scene: Scene) -> StageRecord:
        """Leave a background folder, and in it the traffic, a report and a picture of the worst frames."""
        from dwgs.reconstruct import ReconstructConfig

        insertion: Insertion | None = None
        source: dict[str, Any] = {"clip": self.clip_key()}
        if self.insertion is not None:
            from generator.conditions import read_insertion

            insertion = read_insertion(self.insertion)
            source["insertion"] = fingerprint(self.insertion)
        config = ReconstructConfig.draft(self.seed) if self.draft else ReconstructConfig.joint(self.seed)
        return joint_stage(scene, insertion, source, self.out, config)

    def clip_key(self) -> dict:
        """What tells this clip from another."""
        return clip_key(self.clip)


def clip_key(clip) -> dict:
    """Everything that a result depends on, of a clip."""
    if clip.is_street:
        return asdict(clip)
    return {**asdict(clip), "scene": fingerprint(Path(clip.scene))}  # wherever it was named from


def reconstruct_stage(scene: Scene, source: dict, folder: Path, draft: bool, seed: int) -> StageRecord:
    """Fit the background of ``scene`` into ``folder``; what was killed meanwhile goes on."""
    from dwgs.optimize import Checkpoint
    from dwgs.reconstruct import ReconstructConfig, reconstruct

    config = ReconstructConfig.draft(seed) if draft else ReconstructConfig(seed=seed)
    inputs = {"source": source, "config": asdict(config)}

    def make(folder: Path, progress: Bar) -> dict:
        from dwgs.formats import background_folder

        background, report = progress.follow(reconstruct(scene, config, Checkpoint(parts / FIT)))
        background_folder.write(background, folder)
        return report

    with unfinished(folder, stage_key("reconstruct", inputs)) as parts:
        return run_stage(folder, "reconstruct", inputs, make)


def joint_stage(
    scene: Scene, insertion: Insertion | None, source: dict, folder: Path, config: "ReconstructConfig"
) -> StageRecord:
    """Fit street and traffic of ``scene`` together into ``folder``; what was killed meanwhile goes on."""
    from dwgs.optimize import Checkpoint
    from dwgs.reconstruct import reconstruct_jointly

    inputs = {"source": source, "config": asdict(config), "joint": True}
    for track in scene.tracks:
        if not re.fullmatch(r"\w[\w-]*", track.id):
            raise InputError(f"the id of a track names its folder: letters, digits, _ and -; rename track '{track.id}'")

    def make(folder: Path, progress: Bar) -> dict:
        from PIL import Image

        from dwgs.formats import asset_folder, background_folder
        from dwgs.reconstruct.worst import picture_of_worst
        from dwgs.scene.trajectory_file import write_trajectory

        fit = reconstruct_jointly(scene, config, insertion, Checkpoint(parts / FIT))
        reconstruction, report = progress.follow(fit)
        background_folder.write(reconstruction.background, folder)
        for actor in reconstruction.actors:
            asset_folder.write(actor.asset, folder / TRAFFIC / actor.id)
            write_trajectory(actor.trajectory, folder / TRAFFIC / actor.id / TRAJECTORY_FILE)
        (folder / "report.json").write_text(json.dumps(report, indent=2))
        Image.fromarray(picture_of_worst(reconstruction, scene, report)).save(folder / "worst.png")
        return report

    with unfinished(folder, stage_key("reconstruct", inputs)) as parts:
        return run_stage(folder, "reconstruct", inputs, make)
