"""The dark car that overtakes on the left of a recorded drive: what cameras saw, annotated boxes, no truth."""

from pathlib import Path

from rich.progress import Progress

from benchmarks.metric import Metric
from benchmarks.workloads.oracle import follow
from dwgs.cli.distill import insertion_of_track
from dwgs.datasets import open_scene, resize_scene
from dwgs.distill import DistillConfig, distill
from dwgs.reconstruct import ReconstructConfig, reconstruct

CAR, CLIP = "0d238564", range(41, 79)
"""Sequence 002: the track, and the frames that show at least 30 % of it."""
WIDTH, HEIGHT = 720, 480
"""The working size [px]."""


def run(folder: Path, seconds: float, reconstruction: ReconstructConfig, progress: Progress) -> list[Metric]:
    """Reconstruct the street of PandaSet's sequence in ``folder``, then distil the car in the time given."""
    drive = open_scene(folder)
    scene = resize_scene(drive.select([drive.main_camera]), WIDTH, HEIGHT)
    background, fit = follow(reconstruct(scene, reconstruction), progress, "reconstruct")
    clip = scene.select(frames=CLIP)
    insertion = insertion_of_track(drive, CAR)
    config = DistillConfig(seconds=seconds)
    report = follow(distill(clip, background, insertion, config), progress, "recorded car").report
    return [
        Metric("distill.pandaset.background_psnr_heldout", fit["psnr_heldout"], "dB"),
        Metric("distill.pandaset.background_seconds", fit["seconds"], "s"),
        Metric("distill.pandaset.psnr_roi_heldout", report["psnr_roi_heldout"], "dB"),
        Metric("distill.pandaset.psnr_object_heldout", report["psnr_object_heldout"], "dB"),
        Metric("distill.pandaset.psnr_roi_train", report["psnr_roi_train"], "dB"),
        Metric("distill.pandaset.steps", report["steps"], ""),
    ]
