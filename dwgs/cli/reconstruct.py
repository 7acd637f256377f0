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
    steps: int | None = None
    """Steps of the optimiser; by default what the clip's length asks for."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        """Leave a background folder."""
        scene = self.clip.open()
        record = reconstruct_stage(scene, self.clip_key(), self.out, self.steps, self.seed)
        say(f"held-out PSNR {decibels(record.report['psnr_heldout'])}, {record.report['gaussians']:,} Gaussians")
        say(f"next: dwgs distill {self.clip.scene} --track ID --background {self.out} -o asset/")

    def clip_key(self) -> dict:
        """What tells this clip from another."""
        return clip_key(self.clip)


def clip_key(clip) -> dict:
    """Everything that a result depends on, of a clip."""
    source = [] if clip.is_street else fingerprint(Path(clip.scene))
    return {**asdict(clip), "files": source}


def reconstruct_stage(scene: Scene, source: dict, folder: Path, steps: int | None, seed: int) -> StageRecord:
    """Fit the background of ``scene`` into ``folder``."""

    def make(draft: Path, progress: Bar) -> dict:
        from dwgs.formats import background_folder
        from dwgs.reconstruct import ReconstructConfig, reconstruct

        config = ReconstructConfig(seed=seed) if steps is None else ReconstructConfig(seed=seed, steps=steps)
        background, report = progress.follow(reconstruct(scene, config))
        background_folder.write(background, draft)
        return report

    return run_stage(folder, "reconstruct", {"source": source, "steps": steps, "seed": seed}, make)
