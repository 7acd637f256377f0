"""A street with its traffic, frozen: what it looks like at any frame, and how far that is from what was recorded."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.metrics import psnr, ssim
from dwgs.reconstruct.evaluate import mean, show_background
from dwgs.reconstruct.traffic import Actor
from dwgs.scene import Background, Frame, Scene
from dwgs.scene.silhouette import box_silhouette
from dwgs.splat import Objects, Splats

FEW_PIXELS = 64
"""What covers fewer of an image is not scored in it."""
WORST = 2
"""So many frames of the lowest PSNR are named, of those that taught and of those that judged."""


@dataclass(frozen=True)
class Reconstruction:
    """All of a drive."""

    background: Background
    actors: tuple[Actor, ...]

    def show(self, frame: Frame) -> NDArray[np.float32]:
        """What its camera sees [H, W, 3], with all that moves where it is at that time."""
        time, known = frame.camera.time, self.background.poses.get((frame.camera_name, frame.index))
        camera = frame.camera if known is None else frame.camera.at(known)
        there = [k for k, actor in enumerate(self.actors) if actor.trajectory.covers(time)]
        clouds = [self._clouds[0], *(self._clouds[k + 1] for k in there)]
        poses = np.stack([np.eye(4), *(self.actors[k].trajectory.at(time) for k in there)])
        objects = Objects(tuple(map(len, clouds)), torch.from_numpy(poses).float())
        return show_background(self.background, Splats.cat(clouds), camera, frame.camera_name, objects)

    def owners(self, frame: Frame) -> NDArray[np.int64]:
        """Number of the actor whose box is the nearest at each pixel [H, W], -1 where there is none."""
        owner = np.full((frame.camera.height, frame.camera.width), -1)
        time = frame.camera.time
        there = [(k, actor) for k, actor in enumerate(self.actors) if actor.trajectory.covers(time)]
        boxes = [(k, actor.trajectory.at(time), actor.asset.size) for k, actor in there]
        for k, world_from_box, size in sorted(
            boxes, key=lambda box: -np.linalg.norm(box[1][:3, 3] - frame.camera.position)
        ):
            owner[box_silhouette(frame.camera, world_from_box, size)] = k
        return owner

    @cached_property
    def _clouds(self) -> list[Splats]:
        clouds = [self.background.gaussians, *(actor.asset.gaussians for actor in self.actors)]
        return [Splats.from_gaussians(cloud) for cloud in clouds]


def evaluate_whole(reconstruction: Reconstruction, scene: Scene, heldout: set[int], threads: int = 2) -> dict[str, Any]:
    """PSNR [dB] and SSIM of whole images, of every frame, every camera and every actor; and where it fails.

    ``heldout`` names the frames that judge; all others taught. The keys, JSON values all of them:

    - ``psnr_train``, ``ssim_train``, ``psnr_heldout``, ``ssim_heldout``: means over images, None over none; likewise
      ``psnr_static_train`` and so on, outside all boxes, and ``psnr_actors_train``, inside them;
    - ``cameras``: the same by name;
    - ``frames``: the same of each image;
    - ``actors``: each, with its PSNR over all pixels at which its box is the nearest, how many frames show it, and
      what its asset's quality says;
    - ``worst``: the images of the lowest PSNR, the worst first: of those that taught, then of those that judged.
    """
    count = len(reconstruction.actors)

    def score(frame: Frame) -> tuple[dict[str, Any], NDArray[np.float64]]:
        image, target = np.clip(reconstruction.show(frame), 0, 1), frame.pixels / np.float32(255)
        owner = reconstruction.owners(frame)
        squares = np.bincount(owner.ravel() + 1, ((image - target) ** 2).mean(-1).ravel(), count + 1)
        pixels = np.bincount(owner.ravel() + 1, minlength=count + 1)
        return {
            "camera": frame.camera_name,
            "frame": frame.index,
            "heldout": frame.index in heldout,
            "psnr": round(psnr(image, target), 3),
            "ssim": round(ssim(image, target), 4),
            "psnr_static": _decibels(squares[0], pixels[0]),
            "psnr_actors": _decibels(squares[1:].sum(), pixels[1:].sum()),
        }, np.stack([squares[1:], pixels[1:]]).astype(np.float64)

    with ThreadPoolExecutor(threads) as pool:  # a frame for each thread
        scored = list(pool.map(score, scene.all_frames()))
    frames = [entry for entry, _ in scored]
    by_actor = np.array([sums for _, sums in scored]).reshape(len(frames), 2, count)
    is_heldout = np.array([entry["heldout"] for entry in frames])
    report: dict[str, Any] = _means(frames)
    report["cameras"] = {name: _means([f for f in frames if f["camera"] == name]) for name in scene.frames}
    report["frames"] = frames
    report["actors"] = [
        {
            "id": actor.id,
            "category": actor.asset.category,
            "gaussians": len(actor.asset.gaussians),
            "frames": int((by_actor[:, 1, k] >= FEW_PIXELS).sum()),
            "pixels": int(by_actor[:, 1, k].sum()),
        }
        | {
            f"psnr_{group}": _decibels(*_shown(by_actor[chosen, :, k]))
            for group, chosen in (("train", ~is_heldout), ("heldout", is_heldout))
        }
        | actor.asset.quality
        for k, actor in enumerate(reconstruction.actors)
    ]
    ranked = sorted(frames, key=lambda f: f["psnr"])
    worst = [f for judges in (False, True) for f in [f for f in ranked if f["heldout"] == judges][:WORST]]
    report["worst"] = [{key: f[key] for key in ("camera", "frame", "heldout", "psnr")} for f in worst]
    return report


def _shown(sums: NDArray[np.float64]) -> NDArray[np.float64]:
    """[2] squared errors and pixels, of those frames [F, 2] that show enough."""
    return sums[sums[:, 1] >= FEW_PIXELS].sum(0)


def _means(frames: list[dict[str, Any]]) -> dict[str, float | None]:
    return {
        f"{measure}_{group}": mean([f[measure] for f in frames if f["heldout"] == (group == "heldout")])
        for group in ("train", "heldout")
        for measure in ("psnr", "ssim", "psnr_static", "psnr_actors")
    }


def _decibels(squares: float, pixels: float) -> float | None:
    """PSNR of a sum of squared errors; None over no pixels."""
    return round(-10 * math.log10(max(squares / pixels, 1e-10)), 3) if pixels else None
