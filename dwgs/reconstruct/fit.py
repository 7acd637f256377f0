"""Scene -> Background."""

import time
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.optimize import (
    Checkpoint,
    Evaluated,
    Event,
    Grown,
    Preparing,
    Step,
    count_steps,
    dssim,
    hold_then_decay,
    view_order,
    weighted_l1,
)
from dwgs.optimize.growth import sample_errors
from dwgs.reconstruct.config import ReconstructConfig
from dwgs.reconstruct.discs import blobs
from dwgs.reconstruct.evaluate import evaluate
from dwgs.reconstruct.initialize import initialize
from dwgs.reconstruct.model import Street
from dwgs.reconstruct.sky import SHELL_RADIUS
from dwgs.reconstruct.traffic import Traffic
from dwgs.reconstruct.views import TrainingView, evenly, read_view, split_frames
from dwgs.scene import Background, Frame, Gaussians, InputError, Scene
from dwgs.scene.ground import Ground
from dwgs.scene.moving import static_points
from dwgs.scene.sky import pixel_rays

COARSE = 0.15
"""The first part of the schedule looks at images of half the size."""
GROWTH = (0.12, 0.25, 0.40)
"""Parts of the schedule after which the cloud grows."""
GROWTH_VIEWS = 10
"""How many views are searched for errors."""
SEEDLING_OPACITY = 0.5
CONFINE_EVERY = 50
"""Steps after which traffic is put back into its boxes, and at the end."""
SSIM_SHARE = 0.2
"""Of the photometric loss; the rest is L1."""
DEPTH_WEIGHT = 0.05
"""Of the relative LiDAR depth error."""
HIDDEN_WEIGHT = 0.05
"""Of pixels under traffic, where the target is what the first cloud shows."""
NO_POINTS = np.zeros((0, 3), np.float32)
JUDGED_VIEWS = 16
"""At most so many of the frames that teach are scored at the end."""


def reconstruct(
    scene: Scene, config: ReconstructConfig, checkpoint: Checkpoint | None = None
) -> Generator[Event, None, tuple[Background, dict[str, Any]]]:
    """Fit the static street of ``scene``, step by step.

    Every 8th instant is held out: it never touches colours, geometry or poses, and judges. What was interrupted
    goes on from its ``checkpoint``, to the same bytes.

    Returns:
        As the generator's return value, the `Background` and a report of JSON values.

    Raises:
        InputError: The scene has no LiDAR, or none that its cameras see.
    """
    begin = time.perf_counter()
    prepared = yield from prepare(scene, config)
    teaching, judging, views = prepared.teaching, prepared.judging, prepared.views
    street = Street(scene, teaching, prepared.gaussians, prepared.sky, Traffic({}, teaching))
    with ThreadPoolExecutor(config.threads) as pool:
        views = list(pool.map(lambda i: _imagine_hidden(street, i, views[i], threads=1), range(len(views))))
    yield from learn(street, views, config, checkpoint)

    background = street.to_background(judging)
    judged = evenly(views, JUDGED_VIEWS) + [read_view(scene, f, prepared.ground, NO_POINTS) for f in judging]
    report = evaluate(background, judged, {frame.index for frame in judging}, config.threads)
    report |= summary(street, background, config) | {"seconds": round(time.perf_counter() - begin, 2)}
    if report["psnr_heldout"] is not None:
        yield Evaluated(config.steps, report["psnr_heldout"])
    return background, report


@dataclass(frozen=True)
class Prepared:
    """What is known of the static street before the first step."""

    teaching: list[Frame]
    judging: list[Frame]
    views: list[TrainingView]
    """Of the frames that teach, traffic hidden."""
    ground: Ground
    gaussians: Gaussians
    sky: NDArray[np.float32]


def prepare(scene: Scene, config: ReconstructConfig) -> Generator[Event, None, Prepared]:
    """Read the frames that teach, and begin with Gaussians on the LiDAR's points; see `reconstruct`."""
    teaching, judging = split_frames(scene)
    if not scene.sweeps:
        raise InputError(
            f"a street is reconstructed from images and LiDAR, but '{scene.name}' has no LiDAR sweep; "
            "record one, or give points of a structure-from-motion run as a sweep"
        )
    ground = Ground.from_sweeps(scene.sweeps, scene.ego)
    static: dict[int, NDArray[np.float32]] = {}
    for i, sweep in enumerate(scene.sweeps, 1):
        static[sweep.frame_index] = static_points(scene, sweep)
        yield Preparing("sweeps", i, len(scene.sweeps))
    views = []
    with ThreadPoolExecutor(config.threads) as pool:
        for view in pool.map(lambda f: read_view(scene, f, ground, static.get(f.index, NO_POINTS)), teaching):
            views.append(view)
            yield Preparing("frames", len(views), len(teaching))
    gaussians, sky = initialize(scene, ground, static, views, config)
    return Prepared(teaching, judging, views, ground, gaussians, sky)


def learn(
    street: Street, views: list[TrainingView], config: ReconstructConfig, checkpoint: Checkpoint | None
) -> Generator[Event, None, None]:
    """The whole schedule, from where the checkpoint left it."""
    random, done = torch.Generator().manual_seed(config.seed), 0
    saved = None if checkpoint is None else checkpoint.load()
    if saved is not None:
        done = saved["step"]
        random.set_state(saved["random"])
        street.load_state_dict(saved["street"])
    yield Grown(done, len(street))
    growths = [round(part * config.steps) for part in GROWTH]
    for pace, i in zip(count_steps(config.steps), view_order(len(views), config.seed), strict=False):
        step = pace.step
        if step <= done:
            continue
        view = views[i].halved() if step <= COARSE * config.steps else views[i]
        loss = _loss(street, i, view, config.threads)
        loss.backward()
        street.step(hold_then_decay(pace.progress))
        if step % CONFINE_EVERY == 0 or step == config.steps:
            street.confine()
        yield Step(step, config.steps, float(loss.detach()))
        if step in growths:
            street.grow(_seedlings(street, views, config.grown, random, config.threads))
            yield Grown(step, len(street))
        if checkpoint is not None:
            checkpoint.offer(partial(_state, step, random, street))


def _state(step: int, random: torch.Generator, street: Street) -> dict[str, Any]:
    """Everything that further steps depend on."""
    return {"step": step, "random": random.get_state(), "street": street.state_dict()}


def summary(street: Street, background: Background, config: ReconstructConfig) -> dict[str, Any]:
    """What a report says of the fit itself."""
    rotation, translation = street.pose_corrections()
    return {
        "gaussians": len(background.gaussians),
        "steps": config.steps,
        "pose_correction_rms_deg": round(float(np.degrees(rotation)), 4),
        "pose_correction_rms_m": round(translation, 5),
    }


def _loss(street: Street, i: int, view: TrainingView, threads: int) -> Tensor:
    """0.8 L1 + 0.2 (1 - SSIM) against the pixels, and the relative error of the depth where LiDAR knows it.

    The depth is premultiplied: it is right only where the street is opaque.
    """
    rgb, rendering = street.show(i, view.camera, threads)
    target = _tensor(view)
    weight = torch.where(torch.from_numpy(view.hidden), HIDDEN_WEIGHT, 1.0)
    loss = (1 - SSIM_SHARE) * weighted_l1(rgb, target, weight)
    loss = loss + 2 * SSIM_SHARE * dssim(rgb, target, weight)
    if len(view.depths):
        rows, columns = torch.from_numpy(view.depth_pixels).T
        depth = rendering.depth[rows, columns] / torch.from_numpy(view.depths)
        loss = loss + DEPTH_WEIGHT * (depth - 1).abs().mean()
    return loss + street.traffic.prior(i)


def _tensor(view: TrainingView) -> Tensor:
    """Its colours [H, W, 3] in [0, 1], plane by plane like a rendering's."""
    planes = torch.from_numpy(view.pixels).permute(2, 0, 1).contiguous()
    return (planes.float() / 255).permute(1, 2, 0)


def _imagine_hidden(street: Street, i: int, view: TrainingView, threads: int) -> TrainingView:
    """The view with what the street shows now in place of the traffic.

    Held to with a small weight, it keeps what other frames do not contradict.
    """
    if not view.hidden.any():
        return view
    with torch.no_grad():
        _, rendering = street.show(i, view.camera, threads)
    rgb = rendering.rgb.numpy() + (1 - rendering.alpha.numpy())[..., None] * (view.pixels / np.float32(255))
    imagined = (np.clip(rgb, 0, 1) * 255).round().astype(np.uint8)
    return replace(view, pixels=np.where(view.hidden[..., None], imagined, view.pixels))


def _seedlings(
    street: Street, views: list[TrainingView], count: int, generator: torch.Generator, threads: int
) -> dict[int, Gaussians]:
    """New Gaussians by view, on pixels that are still wrong, one pixel large, as deep as the street is there."""
    chosen = evenly(list(range(len(views))), GROWTH_VIEWS)
    clouds = {}
    for i in chosen:
        view, camera = views[i], street.camera(i)
        with torch.no_grad():
            rgb, rendering = street.show(i, view.camera, threads)
        error = (rgb - _tensor(view)).abs().mean(-1) * torch.from_numpy(~view.hidden)
        pixels = sample_errors(error, count // len(chosen), generator)
        rows, columns = pixels.numpy().T
        depths = rendering.expected_depth[pixels[:, 0], pixels[:, 1]].double().numpy()
        is_sky = rendering.alpha[pixels[:, 0], pixels[:, 1]].numpy() < 0.5
        depths[is_sky] = SHELL_RADIUS
        points = camera.position + depths[:, None] * pixel_rays(camera)[rows, columns]
        radii = depths / camera.K[0, 0]
        clouds[i] = blobs(points, radii, view.pixels[rows, columns] / 255, SEEDLING_OPACITY)
    return clouds
