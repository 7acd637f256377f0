"""How well the composited vehicle explains the frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.distill.coverage import sector_of
from dwgs.distill.shots import Shot
from dwgs.metrics import psnr, ssim
from dwgs.scene.pose import inverse
from dwgs.splat import Splats, View, render

OBJECT_ALPHA = 0.5
"""A pixel is the vehicle's own where its body alone covers more than this."""


@dataclass(frozen=True)
class Score:
    """One frame against its render."""

    camera_name: str
    index: int
    held_out: bool
    sector: int
    """It was seen from, see `coverage`."""
    psnr_roi: float
    """[dB] over the supervised pixels."""
    ssim_roi: float
    """Over the supervised pixels."""
    psnr_object: float
    """[dB] over supervised pixels that the body covers; NaN where it covers none."""


def score(shot: Shot, view: View, body: Splats, shadow: Splats, threads: int) -> tuple[Score, NDArray[np.float32]]:
    """Score one frame, and the window [h, w, 3] as it is rendered."""
    with torch.no_grad():
        rendered = shot.frozen.exposed(shot.frozen.render(Splats.cat([body, shadow]), view, threads).rgb)
        alpha = render(body, view, threads=threads).alpha
    frame, region = shot.sight.frame, shot.sight.region
    image, target = rendered.numpy(), shot.pixels.astype(np.float32) / 255
    supervised = region.supervised
    return Score(
        frame.camera_name,
        frame.index,
        shot.sight.held_out,
        sector_of(inverse(shot.sight.world_from_vehicle) @ shot.sight.camera.world_from_camera),
        psnr(image, target, supervised),
        ssim(image, target, supervised),
        psnr(image, target, supervised & (alpha.numpy() > OBJECT_ALPHA)),
    ), image


def of_sectors(scores: Sequence[Score], sectors: Sequence[dict]) -> list[dict]:
    """The entries of the sectors, with the means over the held-out frames that look from there; None over no frame."""

    def mean(of: str, sector: int) -> float | None:
        values = [getattr(s, of) for s in scores if s.held_out and s.sector == sector]
        return round(float(np.mean(values)), 4) if values else None

    return [
        entry | {f"{of}_heldout": mean(of, k) for of in ("psnr_roi", "ssim_roi")} for k, entry in enumerate(sectors)
    ]


def summary(scores: Sequence[Score]) -> dict:
    """JSON values: means over held-out and over learnt frames (None over no frame), and every frame's own."""

    def mean(of: str, held_out: bool) -> float | None:
        values = [getattr(s, of) for s in scores if s.held_out == held_out]
        values = [v for v in values if np.isfinite(v)]
        return round(float(np.mean(values)), 4) if values else None

    report: dict = {
        f"{of}_{name}": mean(of, held_out)
        for of in ("psnr_roi", "ssim_roi", "psnr_object")
        for name, held_out in (("heldout", True), ("train", False))
    }
    report["frames"] = [
        {
            "camera": s.camera_name,
            "frame": s.index,
            "heldout": s.held_out,
            "psnr": round(s.psnr_roi, 3) if np.isfinite(s.psnr_roi) else None,
        }
        for s in scores
    ]
    return report
