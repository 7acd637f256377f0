"""dwgs insert: the whole way, from a recorded drive to the edited drive and the vehicle's Gaussians."""

import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from dwgs.cli.backend import BackendOptions
from dwgs.cli.condition import condition_stage, insertion_key
from dwgs.cli.distill import distill_config, distill_stage
from dwgs.cli.films import film_stage
from dwgs.cli.generate import generate_stage
from dwgs.cli.options import ClipOptions, PlacementOptions, VehicleOptions, author_insertion
from dwgs.cli.progress import decibels, say
from dwgs.cli.reconstruct import clip_key, reconstruct_stage
from dwgs.cli.record import record_stage
from dwgs.cli.render import read_driven
from dwgs.cli.report import write_page
from dwgs.cli.stage import StageRecord, versions
from dwgs.files import new_file


@dataclass(frozen=True)
class Insert:
    """Put a vehicle into a recorded drive, and distil it: edited video, background, asset, report."""

    clip: ClipOptions
    choice: VehicleOptions
    placement: PlacementOptions
    generator: BackendOptions
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for everything; stages whose inputs have not changed are not run again."""
    draft: bool = False
    """Reconstruct the background with half the Gaussians and a tenth of the steps."""
    distill_steps: int | None = None
    """Steps of the vehicle's optimiser; by default what suits the video."""
    seed: int = 0
    """Of everything random."""

    def run(self) -> None:
        """Run the chain."""
        from dwgs.datasets import folder as scene_folder
        from dwgs.formats import background_folder
        from viewer.scene_graph import SceneGraph

        start = time.perf_counter()
        clip, stages = self.clip, {}
        scene = clip.open()
        self.generator.open().check(scene)  # a backend that cannot work says so before an hour is spent
        insertion, notes = author_insertion(clip, scene, self.choice, self.placement)
        for note in notes:
            say(note)
        key = insertion_key(clip, self.choice, self.placement)
        if clip.is_street:
            stages["record"] = record_stage(clip, self.out / "recorded")
            scene = scene_folder.read(self.out / "recorded")
        # the cheap stages first: what is wrong with an insertion shows before the long fit
        stages["condition"] = condition_stage(scene, insertion, key, self.out / "conditions")
        stages["reconstruct"] = reconstruct_stage(scene, clip_key(clip), self.out / "background", self.draft, self.seed)
        stages["generate"] = generate_stage(
            scene, self.out / "conditions", key, self.out / "edited", self.generator, self.seed
        )
        edited = scene_folder.read(self.out / "edited")
        background = background_folder.read(self.out / "background")
        before = background_folder.fingerprint(self.out / "background")
        source = {"edited": stages["generate"].key, "background": before}
        stages["distill"] = distill_stage(
            edited, background, insertion, source, self.out / "asset", distill_config(self.distill_steps, self.seed)
        )
        unchanged = before == background_folder.fingerprint(self.out / "background")
        asset, trajectory = read_driven(self.out / "asset")
        stages["films"] = film_stage(self.out, scene, edited, asset, stages["distill"].key)
        report = self.report(stages, notes, unchanged, time.perf_counter() - start)
        with new_file(self.out / "report.json") as draft:
            draft.write_text(json.dumps(report, indent=2, default=str))
        write_page(self.out, report, scene, edited, SceneGraph(background, [(asset, trajectory)]))
        self.say_result(report)

    def report(
        self, stages: dict[str, StageRecord], notes: list[str], unchanged: bool, seconds: float
    ) -> dict[str, Any]:
        """Everything that was measured, for programs."""
        return {
            "command": "dwgs " + " ".join(sys.argv[1:]),
            "settings": asdict(self),
            "versions": versions(),
            "assumed": notes,
            "seconds": round(seconds, 1),
            "peak_memory_mib": max(stage.peak_memory_mib for stage in stages.values()),
            "background_unchanged": unchanged,
            "stages": {
                name: {
                    "seconds": stage.seconds,
                    "peak_memory_mib": stage.peak_memory_mib,
                    "skipped": stage.skipped,
                }
                for name, stage in stages.items()
            },
            "reconstruct": stages["reconstruct"].report,
            "distill": stages["distill"].report,
        }

    def say_result(self, report: dict[str, Any]) -> None:
        """The result in four lines, and what to type next."""
        distill, reconstruct = report["distill"], report["reconstruct"]
        say(f"background  held-out PSNR {decibels(reconstruct['psnr_heldout'])}")
        say(
            f"vehicle     held-out ROI PSNR {decibels(distill['psnr_roi_heldout'])}, {distill['gaussians']:,} Gaussians"
        )
        say(f"everything  {report['seconds']:.0f} s, {report['peak_memory_mib']:.0f} MiB at most")
        say(f"look at     {self.out / 'report.html'}, {self.out / 'after.mp4'}, {self.out / 'orbit.mp4'}")
        scene = self.out / "recorded" if self.clip.is_street else self.clip.scene
        say(
            f"next        dwgs render {scene} --background {self.out / 'background'} "
            f"--asset {self.out / 'asset'} --move 3 0 0 -o {self.out / 'moved.mp4'}"
        )
