"""Whether a trajectory that trembles is put right: noise goes in, and what is left of it is held against the truth.

The embedded street with the true vehicle in it. What all frames are off by together is no error of a pose: the
vehicle's Gaussians lie as much elsewhere in its frame. It is told apart.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from scipy.spatial.transform import Rotation

from benchmarks.metric import Metric
from benchmarks.workloads.drives import inserted
from benchmarks.workloads.oracle import ExactBackground, follow
from dwgs.datasets import folder
from dwgs.distill import DistillConfig, distill
from dwgs.distill.poses import BoxPoses
from dwgs.scene import Insertion, Scene, Trajectory
from dwgs.scene.pose import inverse, pose
from dwgs.street import Street

SHAKEN = np.repeat((np.radians(0.5), 0.05), 3)
"""Standard deviation of the noise about and along each axis of the vehicle [rad, m], frame by frame."""
AXES = ("along", "across", "up")
"""The vehicle's."""


def run(street: Street, drives: Sequence[str], steps: int, seeds: int, progress: Progress) -> list[Metric]:
    """Distil each drive with its true trajectory, then with noise on it, as it is and refined, for each seed."""
    task = progress.add_task("record", total=street.frames)
    street.render_all(lambda done, _total: progress.update(task, completed=done))
    exact, metrics, config = ExactBackground(street), [], DistillConfig(steps=steps)
    times = np.array([street.camera(i).time for i in range(street.frames)])
    for drive in drives:
        truth = inserted(street, drive)
        name = "distill.street" if drive == "street" else f"distill.street_{drive}"
        with TemporaryDirectory() as temporary:
            task = progress.add_task(f"film {drive}", total=street.frames)
            folder.write(
                street.oracle(truth),
                Path(temporary) / "oracle",
                lambda done, _, task=task: progress.update(task, completed=done),
            )
            scene = folder.read(Path(temporary) / "oracle")

            def fit(insertion: Insertion, title: str, scene: Scene = scene):
                return follow(distill(scene, exact, insertion, config), progress, title)

            clean = fit(truth, f"{drive}, true")
            moved = errors(clean.trajectory, truth.trajectory, times)
            metrics.append(Metric(f"{name}.poses.psnr_true", clean.report["psnr_roi_heldout"], "dB"))
            metrics.append(
                Metric(f"{name}.poses.moved_without_noise_cm", 100 * float(np.abs(moved[:, 3:]).max()), "cm")
            )
            for seed in range(seeds):
                shaken = replace(truth, trajectory=shake(truth.trajectory, times, seed))
                refined = fit(shaken, f"{drive}, noise {seed}")
                with patch.object(BoxPoses, "is_rough", return_value=False):
                    unrefined = fit(shaken, f"{drive}, noise {seed} left")
                key = f"{name}.poses.noise_{seed}"
                off = errors(refined.trajectory, truth.trajectory, times)
                metrics += [
                    Metric(f"{key}.psnr_refined", refined.report["psnr_roi_heldout"], "dB"),
                    Metric(f"{key}.psnr_unrefined", unrefined.report["psnr_roi_heldout"], "dB"),
                    *left(key, off),
                ]
    return metrics


def shake(trajectory: Trajectory, times: NDArray[np.float64], seed: int) -> Trajectory:
    """The trajectory at these times, every pose off by itself."""
    noise = SHAKEN * np.random.default_rng(seed).normal(size=(len(times), 6))
    return Trajectory(times, trajectory.at(times) @ pose(Rotation.from_rotvec(noise[:, :3]).as_matrix(), noise[:, 3:]))


def errors(trajectory: Trajectory, truth: Trajectory, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """[T, 6] rotation vectors [rad] and shifts [m] from the true poses, about and along their own axes."""
    off = np.array([inverse(truth.at(time)) @ trajectory.at(time) for time in times])
    return np.hstack([Rotation.from_matrix(off[:, :3, :3]).as_rotvec(), off[:, :3, 3]])


def left(key: str, off: NDArray[np.float64]) -> list[Metric]:
    """Root mean squares over frames, by axis and over all three, without what all frames share; that, too."""
    metrics, shared = [], np.median(off, axis=0)
    for unit, scale, part in (("cm", 100.0, np.s_[3:]), ("deg", np.degrees(1.0), np.s_[:3])):
        rms = scale * np.sqrt(((off - shared)[:, part] ** 2).mean(0))
        metrics += [Metric(f"{key}.left_{unit}_{axis}", float(x), unit) for axis, x in zip(AXES, rms, strict=True)]
        metrics.append(Metric(f"{key}.left_{unit}", float(np.sqrt((rms**2).mean())), unit))
        metrics.append(Metric(f"{key}.shared_{unit}", scale * float(np.linalg.norm(shared[part])), unit))
    return metrics
