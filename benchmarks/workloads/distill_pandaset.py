"""Vehicles before a recorded street: the dark car that overtakes in it, and one of a file that was never there.

Of the first there are what cameras saw and annotated boxes, no truth; the second is what the default backend painted.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.progress import Progress

from benchmarks.metric import Metric
from benchmarks.workloads.oracle import follow
from dwgs.cli.distill import insertion_of_track
from dwgs.datasets import folder, open_scene, resize_scene
from dwgs.distill import DistillConfig, distill
from dwgs.reconstruct import ReconstructConfig, reconstruct
from dwgs.scene import Background, Insertion, Scene
from dwgs.scene.placement import place_ahead
from generator.composite import CompositeGenerator
from generator.conditions import make_conditions
from generator.conditions.points import load_vehicle

CAR, CLIP = "0d238564", range(41, 79)
"""Sequence 002: the track, and the frames that show at least 30 % of it."""
AHEAD, LEFT, EDITED = 14.0, 3.3, range(30, 79)
"""Where the vehicle of a file begins [m], and when."""
WIDTH, HEIGHT = 720, 480
"""The working size [px]."""


def run(
    source: Path, vehicle: Path | None, seconds: Sequence[float], reconstruction: ReconstructConfig, progress: Progress
) -> list[Metric]:
    """Reconstruct the street of PandaSet's sequence in ``source``, then distil its car, and the ``vehicle`` of a file,
    in each of the times given.
    """
    drive = open_scene(source)
    scene = resize_scene(drive.select([drive.main_camera]), WIDTH, HEIGHT)
    background, fit = follow(reconstruct(scene, reconstruction), progress, "reconstruct")
    metrics = [
        Metric("distill.pandaset.background_psnr_heldout", fit["psnr_heldout"], "dB"),
        Metric("distill.pandaset.background_seconds", fit["seconds"], "s"),
    ]
    clip, car = scene.select(frames=CLIP), insertion_of_track(drive, CAR)
    metrics += _reach("distill.pandaset", clip, background, car, seconds, progress)
    if vehicle is not None:
        points, size, _ = load_vehicle(vehicle)
        clip = scene.select(frames=EDITED)
        insertion = Insertion(points, size, place_ahead(clip, size, AHEAD, LEFT, None))
        with TemporaryDirectory() as temporary:
            video = Path(temporary) / "edited"
            task = progress.add_task("paint", total=len(clip.all_frames()))
            edited = CompositeGenerator().generate(
                make_conditions(clip, insertion), 0, lambda done, _: progress.update(task, completed=done)
            )
            folder.write(edited, video)
            edited = folder.read(video)
            metrics += _reach("distill.pandaset_inserted", edited, background, insertion, seconds, progress)
    return metrics


def _reach(
    name: str,
    scene: Scene,
    background: Background,
    insertion: Insertion,
    seconds: Sequence[float],
    progress: Progress,
) -> list[Metric]:
    """What distillations of so many seconds reach, the last of them once more under the plain key."""
    metrics, quality = [], 0.0
    for time in seconds:
        config = DistillConfig(seconds=time)
        report = follow(distill(scene, background, insertion, config), progress, f"{name}, {time:g} s").report
        quality = report["psnr_roi_heldout"]
        metrics += [
            Metric(f"{name}.psnr_at_{time:g}s", quality, "dB"),
            Metric(f"{name}.psnr_object_at_{time:g}s", report["psnr_object_heldout"], "dB"),
            Metric(f"{name}.steps_at_{time:g}s", report["steps"], ""),
        ]
    return [*metrics, Metric(f"{name}.psnr_roi_heldout", quality, "dB")]
