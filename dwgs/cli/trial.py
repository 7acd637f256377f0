"""One drive of an evaluation: the same vehicle put into it by every system, and what comes of it."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from dwgs.cli.cases import Case
from dwgs.cli.condition import condition_stage, insertion_key
from dwgs.cli.distill import distill_config, distill_stage
from dwgs.cli.generate import generate_stage
from dwgs.cli.options import author_insertion
from dwgs.cli.progress import Bar, say
from dwgs.cli.reconstruct import TRAFFIC, clip_key, joint_stage, reconstruct_stage
from dwgs.cli.record import keep_stage, record_stage
from dwgs.cli.render import read_driven, rendered
from dwgs.cli.stage import StageRecord, run_stage
from dwgs.cli.systems import System
from dwgs.scene import Scene

if TYPE_CHECKING:
    from dwgs.evaluation import Measured, Subject
    from dwgs.metrics.network import NetworkFile
    from dwgs.reconstruct import ReconstructConfig

FEATURES = "features.safetensors"
"""Beside a record of measures: what networks saw in the video."""


@dataclass(frozen=True)
class Effort:
    """How much is spent on a trial."""

    draft: bool = False
    """Reconstruct backgrounds with half the Gaussians and a tenth of the steps."""
    distill_steps: int | None = None
    """Steps of each vehicle's optimiser; by default what suits the video."""
    joint: bool = False
    """Reconstruct street and traffic of every video together, too: minutes for each, the paper's measure of
    how well one world explains it."""
    seed: int = 0
    """Of everything random."""

    @property
    def reconstruction(self) -> "ReconstructConfig":
        """How streets are fitted with their traffic."""
        from dwgs.reconstruct import ReconstructConfig

        return ReconstructConfig.draft(self.seed) if self.draft else ReconstructConfig.joint(self.seed)


@dataclass(frozen=True)
class Trial:
    """A drive with all that systems are given, and the folder in which their results stay."""

    folder: Path
    subject: "Subject"
    recording: dict[str, Any]
    """What the recording depends on."""
    source: dict[str, Any]
    """What the recording and the insertion depend on."""
    effort: Effort
    networks: "dict[str, NetworkFile]"
    """By the key of their column."""

    @staticmethod
    def prepare(case: Case, folder: Path, effort: Effort, networks: "dict[str, NetworkFile]") -> "Trial":
        """Record a street, author the insertion, draw the conditions, render the truth where it is known."""
        from dwgs.datasets import folder as scene_folder
        from dwgs.evaluation import Subject
        from generator.conditions import read

        clip = case.clip
        scene = clip.open()
        insertion, notes = author_insertion(clip, scene, case.choice, case.placement)
        for note in notes:
            say(note)
        recording, source, truth = clip_key(clip), insertion_key(clip, case.choice, case.placement), None
        if clip.is_street:
            record_stage(clip, folder / "recorded")
            if case.knows_truth:
                indices = [frame.index for frame in scene.all_frames()]
                truth = clip.street().oracle(insertion).select(frames=range(min(indices), max(indices) + 1))
                keep_stage(truth, "truth", source, folder / "truth")
                truth = scene_folder.read(folder / "truth")
            scene = scene_folder.read(folder / "recorded")
        condition_stage(scene, insertion, source, folder / "conditions-discs")
        conditions = read(folder / "conditions-discs", scene)
        masks = tuple(frame.load_reactive_mask for frame in conditions.frames[scene.main_camera])
        return Trial(folder, Subject(scene, insertion, masks, truth), recording, source, effort, networks)

    def judge(self, system: System) -> "Measured | None":
        """What is measured of a system here; None for the truth where it is not known."""
        if system.choice is None and self.subject.truth is None:
            return None
        video, key = self._video(system)
        own: dict[str, float] = {}
        if system.is_distilled:
            distilled = self._distil(system, video, key)
            if distilled.report["psnr_roi_heldout"] is not None:
                own["distill_psnr"] = distilled.report["psnr_roi_heldout"]
            video, key = self._rendered(system, distilled.key)
        elif self.effort.joint:
            own |= self._explained(system, video, key)
        return self._measured(system, video, key, own)

    def still(self, system: System) -> NDArray[np.uint8]:
        """The middle frame [H, W, 3] of a system that was judged."""
        from dwgs.datasets import folder as scene_folder

        is_truth = system.choice is None and not system.is_distilled
        scene = self.subject.truth if is_truth else scene_folder.read(self.folder / system.name / "edited")
        assert scene is not None
        frames = scene.frames[scene.main_camera]
        return frames[len(frames) // 2].pixels

    def _video(self, system: System) -> tuple[Scene, str]:
        """The video that a system makes, or that its vehicle is distilled from; and what it was made by."""
        from dwgs.datasets import folder as scene_folder

        if system.choice is None:
            assert self.subject.truth is not None
            return self.subject.truth, "truth"
        edited, subject = self.folder / system.source / "edited", self.subject
        conditions, source = self.folder / f"conditions-{system.points}", {**self.source, "points": system.points}
        condition_stage(subject.recorded, subject.insertion, self.source, conditions, system.points)
        record = generate_stage(subject.recorded, conditions, source, edited, system.choice, self.effort.seed)
        return scene_folder.read(edited), record.key

    def _explained(self, system: System, video: Scene, key: str) -> dict[str, float]:
        """PSNR [dB] and SSIM of a joint reconstruction of a video, on the frames that taught it."""
        source = {"insertion": self.source, "edited": key}
        folder = self.folder / system.name / "joint"
        report = joint_stage(video, self.subject.insertion, source, folder, self.effort.reconstruction).report
        return {"joint_psnr": report["psnr_train"], "joint_ssim": report["ssim_train"]}

    def _distil(self, system: System, video: Scene, key: str) -> StageRecord:
        """The vehicle that a video shows, before the reconstructed street."""
        from dwgs.formats import background_folder

        street, effort = self.folder / "background", self.effort
        background = reconstruct_stage(self.subject.recorded, self.recording, street, effort.draft, effort.seed)
        return distill_stage(
            video,
            background_folder.read(street),
            self.subject.insertion,
            {"insertion": self.source, "edited": key, "background": background.key},
            self.folder / system.name / "asset",
            distill_config(self.effort.distill_steps, self.effort.seed),
        )

    def _rendered(self, system: System, key: str) -> tuple[Scene, str]:
        """The street, its traffic and the distilled vehicle as the cameras of the recording see them."""
        from dwgs.datasets import folder as scene_folder
        from dwgs.formats import background_folder
        from viewer.renderer import Renderer
        from viewer.scene_graph import SceneGraph

        recorded, folder = self.subject.recorded, self.folder / system.name
        background = background_folder.read(self.folder / "background")
        traffic, made_by = self._traffic()
        graph = SceneGraph(background, [*map(read_driven, traffic), read_driven(folder / "asset")])
        camera = recorded.all_frames()[0].camera
        with Renderer(camera.width, camera.height) as renderer:
            frames = {
                name: tuple(replace(f, load_pixels=partial(rendered, renderer, graph, background, f)) for f in frames)
                for name, frames in recorded.frames.items()
            }
            inputs = {"asset": key, "traffic": made_by}
            record = keep_stage(replace(recorded, frames=frames), "render", inputs, folder / "edited")
        return scene_folder.read(folder / "edited"), record.key

    def _traffic(self) -> tuple[list[Path], str]:
        """Assets of all that moves in the recording, which the background lacks; and what they were made by."""
        if not any(track.is_moving for track in self.subject.recorded.tracks):
            return [], ""
        whole = self.folder / "whole"
        record = joint_stage(self.subject.recorded, None, self.recording, whole, self.effort.reconstruction)
        return sorted((whole / TRAFFIC).glob("*")), record.key

    def _measured(self, system: System, video: Scene, key: str, own: dict[str, float]) -> "Measured":
        """Everything that is measured of a video, with what its making has measured already."""
        from dwgs.evaluation import Measured, measure
        from dwgs.metrics.network import Network

        def make(draft: Path, progress: Bar) -> dict:
            values = measure(self.subject, video, progress.count)
            if "lpips" in self.networks:
                pairs = (self._pixels(scene) for scene in (video, self.subject.recorded))
                values["lpips"] = Network(self.networks["lpips"]).mean_distance(*pairs)
            save_file(self._features(video), draft / FEATURES)
            return values

        folder = self.folder / system.name / "measured"
        hashes = {key: file.sha256 for key, file in self.networks.items()}
        inputs = {"source": self.source, "video": key, "networks": hashes}
        record = run_stage(folder, "measure", inputs, make)
        reference = self._reference(hashes)
        features = load_file(folder / FEATURES)
        return Measured(record.report | own, {name: (features[name], reference[name]) for name in features})

    def _reference(self, hashes: dict[str, str]) -> dict[str, NDArray]:
        """What networks see in the recorded video."""

        def make(draft: Path, progress: Bar) -> dict:
            save_file(self._features(self.subject.recorded), draft / FEATURES)
            return {}

        if not {"fid", "fvd"} & set(hashes):
            return {}
        folder = self.folder / "features"
        run_stage(folder, "features", {"recording": self.recording, "networks": hashes}, make)
        return load_file(folder / FEATURES)

    def _features(self, scene: Scene) -> dict[str, NDArray]:
        from dwgs.metrics.network import Network

        features = {}
        if "fid" in self.networks:
            features["fid"] = Network(self.networks["fid"]).image_features(self._pixels(scene))
        if "fvd" in self.networks:
            features["fvd"] = Network(self.networks["fvd"]).clip_features(self._pixels(scene))
        return features

    def _pixels(self, scene: Scene):
        return (frame.pixels for frame in scene.frames[self.subject.recorded.main_camera])
