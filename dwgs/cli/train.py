"""dwgs train: a PointAdapter, from recorded drives."""

import json
import os
from dataclasses import asdict, dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from dwgs.cli.options import Clip
from dwgs.cli.progress import Bar, bar, console, say
from dwgs.cli.reconstruct import clip_key
from dwgs.cli.stage import fingerprint, run_stage, versions
from dwgs.files import new_file
from dwgs.scene import InputError

if TYPE_CHECKING:
    from generator.training.cache import Cache
    from generator.training.config import ClipConfig, TrainingConfig
    from generator.wan.encode import Codec
    from generator.wan.weights import Backbone

SETTINGS = "run.json"
"""In a training's folder, once it has ended: what it was told."""
ADAPTER, TRAINED_BACKBONE = "adapter", "trained-backbone"
"""What it leaves there; the backbone where it learnt, too."""
ENCODING = timedelta(days=7)
"""So long the other processes wait for the one that encodes clips."""


@dataclass(frozen=True)
class Train:
    """Teach a PointAdapter to paint recorded vehicles, told of their LiDAR points: the paper's training."""

    scenes: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCENE...")]
    """Folders of recorded drives; 'street' is the embedded one."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for latents, checkpoints, log and adapter; the same command goes on where it stopped."""
    backbone: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of Wan2.1-VACE in diffusers' layout; with the preset tiny, one of toy size is made."""
    preset: Literal["paper", "tiny"] = "paper"
    """Numbers to start from: the paper's, or such that a CPU takes minutes."""
    steps: int | None = None
    """Instead of the preset's."""
    batch: int | None = None
    """Clips per step over all processes, instead of the preset's."""
    rate: float | None = None
    """Learning rate, instead of the preset's."""
    trains: Literal["adapter", "all"] = "adapter"
    """What learns; all is the paper's ablation without an adapter on a frozen backbone."""
    strategy: Literal["global-to-local", "autoregressive"] = "global-to-local"
    """What clips are taught to be given: every fourth frame, or the first."""
    points: Literal["discs", "pixels"] = "discs"
    """How the vehicle's points are drawn; pixels is the paper's ablation."""
    whole_frame: bool = False
    """Teach to paint whole images, told of by the LiDAR points of the whole street: StreetCrafter's way."""
    init: Literal["vace", "zero", "random"] = "vace"
    """What the adapter starts as."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="FIRST-LAST")] = None
    """First and last frame of every drive, as in 0-192; by default all."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = None
    """Width x height [px] of every clip; by default 720x480."""
    shard: bool = False
    """Share the network out among the processes (FSDP2) instead of giving each all of it: for GPUs of 80 GB and
    less."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        """Leave ``adapter/``, and what led to it."""
        import torch
        from accelerate import PartialState

        from generator.training.cache import Cache
        from generator.training.loop import require_processes
        from generator.wan.weights import Backbone

        if not self.scenes:
            raise InputError("training takes at least one drive; name a folder, or street")
        if os.environ.get("ACCELERATE_USE_FSDP", "false").lower() == "true":
            raise InputError("sharing a network out is asked of dwgs train; launch without --use_fsdp, and add --shard")
        clips, config = self.configs()
        process = PartialState(cpu=not torch.cuda.is_available(), timeout=ENCODING)
        console.quiet = not process.is_main_process  # one of several speaks
        require_processes(process.num_processes, config, self.shard)
        with process.main_process_first():
            if process.is_main_process:
                self._make_toy()
            backbone = Backbone.open(self._backbone_folder)
            backbone.load_text()  # computed by the first, where it is not stored yet
            if process.is_main_process:
                self._encode(backbone, clips)
        cache = Cache(self.out / "latents")
        self._say_memory(backbone, cache, config, process.num_processes)
        self._train(backbone, cache, config, process.is_main_process)

    def configs(self) -> "tuple[ClipConfig, TrainingConfig]":
        """The preset, with what was asked for instead."""
        from generator.training.config import PRESETS

        clips, config = PRESETS[self.preset]
        asked = {"steps": self.steps, "batch": self.batch, "rate": self.rate}
        asked = {name: value for name, value in asked.items() if value is not None}
        config = replace(config, trains=self.trains, init=self.init, seed=self.seed, **asked)
        told = {"strategy": self.strategy, "points": self.points, "whole_frame": self.whole_frame}
        return replace(clips, **told, seed=self.seed), config

    @property
    def _backbone_folder(self) -> Path:
        if self.backbone is None and self.preset == "paper":
            raise InputError("training steers a backbone: give --backbone DIR, or --preset tiny, which makes a toy")
        return self.backbone or self.out / "backbone"

    def _make_toy(self) -> None:
        folder = self._backbone_folder
        if self.backbone is None and not folder.exists():
            from generator.wan.tiny import write_tiny_backbone

            write_tiny_backbone(folder, self.seed)
            say(f"'{folder}' is a backbone of toy size with random weights: it shows that every line runs, no more")

    def _encode(self, backbone: "Backbone", config: "ClipConfig") -> None:
        """Fill ``latents/`` unless the same clips are there."""
        drives = [Clip(scene, frames=self.frames, size=self.size) for scene in self.scenes]

        def make(draft: Path, progress: Bar) -> dict:
            from generator.training.cache import write_cache
            from generator.training.clips import clips_of

            clips = (clip for drive in drives for clip in clips_of(drive.open(), config))
            write_cache(clips, _codec(backbone), config, draft, lambda done: progress.count(done, None))
            return {}

        inputs = {
            "drives": [clip_key(drive) for drive in drives],
            "clips": asdict(config),
            "codec": fingerprint(backbone.folder / "vae"),
        }
        run_stage(self.out / "latents", "encode", inputs, make)

    def _say_memory(self, backbone: "Backbone", cache: "Cache", config: "TrainingConfig", processes: int) -> None:
        from generator.training.memory import TrainingFootprint

        whole, branch = backbone.parameters
        footprint = TrainingFootprint.of(
            backbone.config, (whole - branch, branch), cache.shape, config, processes, self.shard
        )
        who = "the process" if processes == 1 else f"each of {processes} processes"
        say(f"{who} takes about {footprint}")

    def _train(self, backbone: "Backbone", cache: "Cache", config: "TrainingConfig", is_main: bool) -> None:
        from generator.training.log import FILMS, Log
        from generator.training.loop import Stepped, Trainer, Validated
        from generator.training.preview import preview

        trainer = Trainer(cache, backbone, config, self.out, self.shard)
        shown = f", and some filmed in '{self.out / FILMS}'" if trainer.held_out else ""
        say(f"{len(trainer.teaching)} clips teach, {len(trainer.held_out)} held-out ones are looked at{shown}")
        if trainer.step:
            say(f"going on after step {trainer.step}")
        log = Log(self.out, trainer.step) if is_main else None
        with bar("train") as progress:
            for event in trainer.run():
                if log is not None:
                    log.write(event)
                if isinstance(event, Stepped):
                    progress.count(event.step, event.steps)
                elif isinstance(event, Validated):
                    progress.tell(f"held-out loss {event.loss:.4f}")
                    clips = preview(trainer)
                    if log is not None:
                        codec = _codec(backbone)
                        log.show(event.step, [clip.film(codec) for clip in clips])
        steered, adapter = trainer.export(self.out)
        if log is not None:
            with new_file(self.out / SETTINGS) as draft:
                draft.write_text(json.dumps({"settings": asdict(self), "versions": versions()}, indent=2, default=str))
        say(f"next: dwgs insert SCENE ... --backend wan --backbone {steered} --adapter {adapter}")


def _codec(backbone: "Backbone") -> "Codec":
    """On the first GPU, or in host memory where there is none."""
    import torch

    if torch.cuda.is_available():
        return backbone.load_codec("cuda", torch.bfloat16)
    return backbone.load_codec()
