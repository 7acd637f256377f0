"""What a distillation says of itself: how good the vehicle is, from where it was seen, and what of it nobody saw."""

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.distill.config import GENERATED
from dwgs.distill.coverage import Coverage
from dwgs.distill.evaluate import Score, of_sectors, score, summary
from dwgs.distill.observe import observations
from dwgs.distill.prepare import Prepared
from dwgs.distill.shots import Shot, Sight
from dwgs.distill.symmetry import mirrored_share
from dwgs.optimize import Event
from dwgs.scene import Gaussians, Insertion, Trajectory, VehicleAsset
from dwgs.splat import Splats, View

COMPLETED = "share_completed_by_symmetry"
"""Key of a report."""
SOLID = 0.5
"""Opacity of a Gaussian that counts for the vehicle's extent."""
QUALITY = (
    *("psnr_roi_heldout", "ssim_roi_heldout", "psnr_object_heldout", "sectors", "side_pixels"),
    *("gaussians_unseen", COMPLETED, "extent", "wheels", "frames_taught"),
    *("pose_correction_rms_m", "pose_correction_most_m", "pose_correction_rms_deg", "pose_correction_most_deg"),
)
"""What of a report an asset tells of itself."""


def judge(
    prepared: Prepared, asset: VehicleAsset, trajectory: Trajectory, threads: int
) -> Generator[Event, None, tuple[dict[str, Any], NDArray[np.uint32]]]:
    """A report, as JSON values, and how many of the frames that taught saw each Gaussian of the body.

    The asset drives along the ``trajectory``, on which it was learnt.
    """
    taught, insertion = prepared.shots, prepared.insertion
    judged = [i for i, sight in enumerate(prepared.sights) if sight.held_out]
    loaded = yield from prepared.load([prepared.sights[i] for i in judged])
    shots = taught | dict(zip(judged, loaded, strict=True))
    looks = ((shots[i], prepared.view(i, shots[i]), _standing(shots[i], asset, trajectory)) for i in taught)
    seen = observations(looks, len(asset.body), threads)
    scores = _scores([(shots[i], prepared.view(i, shots[i])) for i in sorted(shots)], asset, trajectory, threads)
    is_mirrored = prepared.imagined is not None or not insertion.vehicle.is_complete
    return {
        **summary(scores),
        **_coverage([shot.sight for shot in taught.values()], insertion, scores),
        **({} if prepared.poses is None else prepared.poses.report()),
        "kind": "generated" if prepared.recipe is GENERATED else "recorded",
        "gaussians": len(asset.body) + len(asset.shadow),
        "gaussians_body": len(asset.body),
        "gaussians_shadow": len(asset.shadow),
        "gaussians_unseen": int((seen == 0).sum()),
        COMPLETED: round(mirrored_share(asset.body, seen), 4) if is_mirrored else 0.0,
        "size": [float(side) for side in insertion.size],
        "extent": _extent(asset.body),
        "frames_taught": len(taught),
    }, seen


def _standing(shot: Shot, asset: VehicleAsset, trajectory: Trajectory) -> Gaussians:
    """All of the asset as it stands in a frame, in the order of its Gaussians."""
    parts = asset.parts_at(trajectory, shot.sight.frame.camera.time)
    return Gaussians.concatenate([*parts, asset.shadow_at(shot.sight.world_from_vehicle)])


def _scores(shots: list[tuple[Shot, View]], asset: VehicleAsset, trajectory: Trajectory, threads: int) -> list[Score]:
    """Of every frame, held-out and learnt."""

    def judge(look: tuple[Shot, View]) -> Score:
        whole, count = _standing(look[0], asset, trajectory), len(asset.body)
        body, shadow = Splats.from_gaussians(whole[:count]), Splats.from_gaussians(whole[count:])
        return score(*look, body, shadow, threads=1)[0]

    with ThreadPoolExecutor(threads) as pool:  # a frame for each thread
        return list(pool.map(judge, shots))


def _extent(body: Gaussians) -> list[float]:
    """Length, width and height [m] that hold all but a hundredth of what is solid: to be held against the box."""
    solid = body.means[body.opacities > SOLID]
    if not len(solid):
        return [0.0, 0.0, 0.0]
    return [round(float(side), 3) for side in np.subtract(*np.quantile(solid, [0.995, 0.005], axis=0))]


def _coverage(taught: list[Sight], insertion: Insertion, scores: list[Score]) -> dict:
    """From where the frames that taught the vehicle saw it, and how good it is from there."""
    coverage = Coverage(insertion.size)
    for sight in taught:
        camera = sight.region.window.camera(sight.camera)
        coverage.add(camera, sight.world_from_vehicle, sight.region.supervised)
    report = coverage.report()
    return report | {"sectors": of_sectors(scores, report["sectors"])}
