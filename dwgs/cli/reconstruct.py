"""dwgs reconstruct: the street without its traffic."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dwgs.cli.options import ClipOptions
from dwgs.cli.progress import Bar, decibels, say
from dwgs.cli.stage import StageRecord, fingerprint, run_stage
from dwgs.scene import Scene


@dataclass(frozen=True)
class Reconstruct:
    """Reconstruct the static street as Gaussians, without the traffic; then it is frozen."""

    clip: ClipOptions
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the background."""
    draft: bool = False
    """Half the Gaussians and a tenth of the steps."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        """Leave a background folder."""
        scene = self.clip.open()
        record = reconstruct_stage(scene, self.clip_key(), self.out, self.draft, self.seed)
        say(f"held-out PSNR {decibels(record.report['psnr_heldout'])}, {record.report['gaussians']:,} Gaussians")
        say(f"next: dwgs distill {self.clip.scene} --track ID --background {self.out} -o asset/")

    def clip_key(self) -> dict:
        """What tells this clip from another."""
        return clip_key(self.clip)


def clip_key(clip) -> dict:
    """Everything that a result depends on, of a clip."""
    if clip.is_street:
        return asdict(clip)
    return {**asdict(clip), "scene": fingerprint(Path(clip.scene))}  # wherever it was named from


def reconstruct_stage(scene: Scene, source: dict, folder: Path, draft: bool, seed: int) -> StageRecord:
    """Fit the background of ``scene`` into ``folder``."""
    from dwgs.reconstruct import ReconstructConfig, reconstruct

    config = ReconstructConfig.draft(seed) if draft else ReconstructConfig(seed=seed)

    def make(folder: Path, progress: Bar) -> dict:
        from dwgs.formats import background_folder

        background, report = progress.follow(reconstruct(scene, config))
        background_folder.write(background, folder)
        return report

    return run_stage(folder, "reconstruct", {"source": source, "config": asdict(config)}, make)
