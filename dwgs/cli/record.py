"""Scenes that are computed, kept as folders like any other recording."""

from pathlib import Path
from typing import Any

from dwgs.cli.options import Clip
from dwgs.cli.progress import Bar
from dwgs.cli.reconstruct import clip_key
from dwgs.cli.stage import StageRecord, run_stage
from dwgs.scene import Scene


def record_stage(clip: Clip, folder: Path) -> StageRecord:
    """Drive the embedded street once, so that it is a recording on disk."""
    from dwgs.datasets import folder as scene_folder

    def make(draft: Path, progress: Bar) -> dict:
        clip.street().render_all(progress.count)
        scene_folder.write(clip.open(), draft)
        return {}

    return run_stage(folder, "record", clip_key(clip), make)


def keep_stage(scene: Scene, title: str, inputs: dict[str, Any], folder: Path) -> StageRecord:
    """Write a scene whose pixels are computed as they are asked for."""
    from dwgs.datasets import folder as scene_folder

    def make(draft: Path, progress: Bar) -> dict:
        scene_folder.write(scene, draft, progress.count)
        return {}

    return run_stage(folder, title, inputs, make)
