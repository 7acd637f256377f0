"""How well a frozen street shows what its cameras saw."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.metrics import psnr, ssim
from dwgs.reconstruct.views import TrainingView
from dwgs.scene import Background, Camera
from dwgs.scene.sky import sky_image
from dwgs.splat import Objects, Splats, View, render


def evaluate(background: Background, views: list[TrainingView], heldout: set[int], threads: int = 2) -> dict[str, Any]:
    """PSNR [dB] and SSIM of every view, traffic masked out; their means over those that taught, judged.

    ``heldout`` names the frames that judge. Means over nothing are None, as are views that are all traffic.
    """
    splats = Splats.from_gaussians(background.gaussians)

    def score(view: TrainingView) -> dict[str, Any]:
        name, index = view.frame.camera_name, view.frame.index
        camera = view.camera.at(background.poses[name, index])
        target, shown = view.pixels / 255, ~view.hidden
        image = np.where(shown[..., None], show_background(background, splats, camera, name), target)
        scored = shown.any()
        return {
            "camera": name,
            "frame": index,
            "heldout": index in heldout,
            "psnr": round(psnr(image, target, shown), 3) if scored else None,
            "ssim": round(ssim(image, target, shown), 4) if scored else None,
        }

    with ThreadPoolExecutor(threads) as pool:  # a frame for each thread
        frames = list(pool.map(score, sorted(views, key=lambda view: (view.frame.camera_name, view.frame.index))))
    means = {
        f"{measure}_{group}": mean([f[measure] for f in frames if f["heldout"] == (group == "heldout")])
        for group in ("heldout", "train")
        for measure in ("psnr", "ssim")
    }
    return means | {"frames": frames}


def show_background(
    background: Background, splats: Splats, camera: Camera, camera_name: str, objects: Objects | None = None
) -> NDArray[np.float32]:
    """The picture [H, W, 3] of a frozen street from any camera.

    Its Gaussians are ``splats``; with ``objects``, the first of these, and others drive before it.
    """
    with torch.no_grad():
        rendering = render(splats, View.from_camera(camera), objects=objects, threads=1)
    sky = sky_image(background.sky, camera)
    rgb = rendering.rgb.numpy() + (1 - rendering.alpha.numpy())[..., None] * sky
    return rgb * background.exposure.get(camera_name, np.ones(3, np.float32))


def mean(values: list[float | None]) -> float | None:
    """Of those that are known; None over nothing."""
    known = [value for value in values if value is not None]
    return round(float(np.mean(known)), 4) if known else None
