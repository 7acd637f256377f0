"""dwgs generate: the edited video."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from dwgs.cli.backend import BackendChoice, BackendOptions
from dwgs.cli.options import ClipOptions
from dwgs.cli.progress import Bar, say
from dwgs.cli.reconstruct import clip_key
from dwgs.cli.stage import StageRecord, fingerprint, run_stage, stage_key, unfinished
from dwgs.scene import Scene


@dataclass(frozen=True)
class Generate:
    """Make the video in which the vehicle drives: the same cameras, new pixels."""

    clip: ClipOptions
    choice: BackendOptions
    conditions: Path
    """Folder of conditions, from `dwgs condition`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the edited Scene."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        """Leave an edited Scene folder."""
        scene = self.clip.open()
        self.choice.open().check(scene)  # what is wrong with its weights is said before anything is read
        source = {"clip": clip_key(self.clip), "conditions": fingerprint(self.conditions)}
        generate_stage(scene, self.conditions, source, self.out, self.choice, self.seed)
        say(f"next: dwgs distill {self.out} --insertion {self.conditions}/insertion --background bg/ -o asset/")


def generate_stage(
    scene: Scene, conditions: Path, source: dict, folder: Path, choice: BackendChoice, seed: int
) -> StageRecord:
    """Generate the edited Scene of a conditions folder into ``folder``."""

    def make(draft: Path, progress: Bar) -> dict:
        from dwgs.datasets import folder as scene_folder
        from generator.conditions import read

        generator = choice.open(parts)
        for note in generator.check(scene):
            say(note)
        edited = generator.generate(read(conditions, scene), seed, progress.count)
        scene_folder.write(edited, draft)
        return {"generator": generator.name, "frames": len(edited.all_frames())}

    inputs = {"source": source, "generator": choice.key(), "seed": seed}
    with unfinished(folder, stage_key("generate", inputs)) as parts:
        return run_stage(folder, "generate", inputs, make)
