"""The street's oracle video: what distillation alone loses, and what an asset shows where nobody looked.

The oracle renders the true vehicle with its true light, so nothing here is the generator's fault.
"""

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import torch
from rich.progress import Progress

from benchmarks.metric import Metric
from dwgs.distill import DistillConfig, FrozenView, distill
from dwgs.metrics import psnr
from dwgs.reconstruct import ReconstructConfig, reconstruct
from dwgs.scene import Camera, Frame, Track, VehicleAsset
from dwgs.splat import Layers, Projected, Splats, View, render
from dwgs.street import Street, build_street

ORBIT_VIEWS = 16
ORBIT_DISTANCE = 9.0
ORBIT_ELEVATION = np.radians(12.0)
BEHIND = np.pi
"""Azimuth of a sun that lights both sides of the street alike."""
SEEN = 0.02
"""A side counts as seen where its sector holds more than this share of all pixels that taught."""
T = TypeVar("T")


def run(frames: int, steps: int) -> list[Metric]:
    """Fit the vehicle of the embedded street, in so many steps; judge held-out frames and unseen orbit views.

    Once before the street as it is, which leaves the vehicle alone to be at fault, once before a reconstruction. What
    symmetry is worth is measured in that light, which falls from the left, where no camera looks, and in even light.
    """
    street = build_street(frames=frames)
    insertion, config = street.insertion(), DistillConfig(steps=steps)
    with Progress() as progress:
        report, orbit = distil_twice(street, config, progress)
        even_orbit = distil_twice(build_street(frames=(frames + 1) // 2, sun_azimuth=BEHIND), config, progress)[1]
        background, fit = follow(reconstruct(street.scene(), ReconstructConfig()), progress, "reconstruct")
        before_it = distill(street.oracle(insertion), background, insertion, config)
        fitted = follow(before_it, progress, "distill before it").report
    return [
        Metric("oracle.distill.psnr_roi_heldout", report["psnr_roi_heldout"], "dB"),
        Metric("oracle.distill.ssim_roi_heldout", report["ssim_roi_heldout"], ""),
        Metric("oracle.distill.psnr_roi_train", report["psnr_roi_train"], "dB"),
        Metric("oracle.distill.gaussians", report["gaussians"], ""),
        Metric("oracle.distill.fit_seconds", report["seconds"]["fit"], "s"),
        *(Metric(f"oracle.orbit.{key}", value, "dB") for key, value in orbit.items()),
        *(Metric(f"oracle.even_light.{key}", value, "dB") for key, value in even_orbit.items()),
        Metric("oracle.fitted.background_psnr_heldout", fit["psnr_heldout"], "dB"),
        Metric("oracle.fitted.psnr_roi_heldout", fitted["psnr_roi_heldout"], "dB"),
        Metric("oracle.fitted.psnr_object_heldout", fitted["psnr_object_heldout"], "dB"),
    ]


def distil_twice(street: Street, config: DistillConfig, progress: Progress) -> tuple[dict[str, Any], dict[str, float]]:
    """Before the street as it was recorded: the report, and [dB] of orbit views and what symmetry is worth there."""
    task = progress.add_task("record", total=street.frames)
    street.render_all(lambda done, total: progress.update(task, completed=done))
    insertion, exact = street.insertion(), ExactBackground(street)
    scene = street.oracle(insertion)
    fits = [
        follow(distill(scene, exact, insertion, replace(config, symmetry=symmetry)), progress, title)
        for symmetry, title in ((True, "distill"), (False, "distill without symmetry"))
    ]
    shares = np.array([sector["share"] for sector in fits[0].report["sectors"]])
    (seen, unseen), (seen_without, unseen_without) = (orbit_psnr(street, fit.asset, shares) for fit in fits)
    heldout, heldout_without = (fit.report["psnr_roi_heldout"] for fit in fits)
    return fits[0].report, {
        "psnr_seen_sides": seen,
        "psnr_unseen_sides": unseen,
        "symmetry_gain_seen_sides": seen - seen_without,
        "symmetry_gain_unseen_sides": unseen - unseen_without,
        "symmetry_gain_heldout": heldout - heldout_without,
    }


class ExactBackground:
    """The street without the vehicle, as it was recorded: a `dwgs.distill.Frozen` that is never wrong.

    What lies nearer than all of the vehicle is before it, the rest behind.
    """

    def __init__(self, street: Street) -> None:
        self._street = street
        with ThreadPoolExecutor(2) as pool:
            self._depths = list(pool.map(street.depth, range(street.frames)))
        self._index_from_time = {street.camera(i).time: i for i in range(street.frames)}

    def camera(self, frame: Frame) -> Camera:
        """As recorded."""
        return frame.camera

    def freeze(self, camera: Camera, camera_name: str, interval: tuple[float, float]) -> FrozenView:
        """The pixels of a window of a recorded frame, with their depth."""
        index = self._index_from_time[camera.time]
        whole = self._street.camera(index)
        x, y = np.rint((whole.K - camera.K)[:2, 2]).astype(int)
        window = np.s_[y : y + camera.height, x : x + camera.width]
        rgb = torch.from_numpy(self._street.pixels(index)[window].astype(np.float32) / 255)
        depth = torch.from_numpy(self._depths[index][window])
        before = (depth < interval[0]).float()
        depth = depth.nan_to_num(posinf=0)
        front = (rgb * before[..., None], depth * before, 1 - before) if before.any() else None
        behind = 1 - before
        layers = Layers.of(front, (rgb * behind[..., None], depth * behind, (depth > 0).float() * behind))
        return FrozenView(layers, Projected(torch.zeros(0, 16)), torch.ones(3))

    def unexplained(self, tracks: Sequence[Track], time: float) -> Sequence[Track]:
        """All: traffic is masked as before any background."""
        return tracks

    def fingerprint(self) -> str:
        """Of the street's numbers: a seed makes it."""
        return f"street-{self._street.seed}-{self._street.frames}"


def follow(fit: Generator[Any, None, T], progress: Progress, title: str) -> T:
    """Run a fit to its end; gives what it returns."""
    task = progress.add_task(title, total=None)
    while True:
        try:
            event = next(fit)
        except StopIteration as end:
            return end.value
        if hasattr(event, "steps"):
            progress.update(task, completed=event.step, total=event.steps)


def orbit_psnr(street: Street, asset: VehicleAsset, azimuths: np.ndarray) -> tuple[float, float]:
    """Mean PSNR [dB] over the true vehicle's pixels, from sides that taught and from sides that did not.

    Asset and truth stand alone on grey, lit as in the middle of the clip.
    """
    insertion = street.insertion()
    moment = insertion.trajectory.times[len(insertion.trajectory.times) // 2]
    world_from_vehicle = insertion.trajectory.at(moment)
    body = Splats.from_gaussians(asset.body)
    values: dict[bool, list[float]] = {True: [], False: []}
    for azimuth in np.arange(ORBIT_VIEWS) * 2 * np.pi / ORBIT_VIEWS:
        camera = orbit_camera(world_from_vehicle, azimuth, moment)
        truth = street.vehicle_view(camera, insertion, moment)
        with torch.no_grad():
            rendering = render(body, View.from_camera(camera, world_from_vehicle))
        grey = np.float32(127 / 255)
        shown = (rendering.rgb + (1 - rendering.alpha[..., None]) * grey).numpy()
        sector = round(azimuth / (2 * np.pi) * len(azimuths)) % len(azimuths)
        is_seen = bool(azimuths[sector] > SEEN * azimuths.sum())
        values[is_seen].append(psnr(shown, truth.rgb / np.float32(255), truth.vehicle_alpha > 0.5))
    return tuple(float(np.mean(v)) if v else float("nan") for v in (values[True], values[False]))


def orbit_camera(world_from_vehicle: np.ndarray, azimuth: float, moment: float) -> Camera:
    """A camera that looks at the vehicle's centre from that side; azimuth 0 faces its front."""
    flat = np.cos(ORBIT_ELEVATION)
    toward = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(ORBIT_ELEVATION)])
    right = np.cross([0, 0, 1.0], toward)
    right /= np.linalg.norm(right)
    vehicle_from_camera = np.eye(4)
    vehicle_from_camera[:3, :3] = np.stack([right, -np.cross(toward, right), -toward], 1)
    vehicle_from_camera[:3, 3] = ORBIT_DISTANCE * toward
    K = np.array([[620.0, 0, 240], [0, 620.0, 160], [0, 0, 1]])
    return Camera(K, 480, 320, world_from_vehicle @ vehicle_from_camera, moment)
