"""What moves, before the first step: the points that the LiDAR has of them, coloured by the frames that saw them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dwgs.reconstruct.depth_samples import depth_samples, pixels_of
from dwgs.reconstruct.views import TrainingView
from dwgs.scene import Insertion, LidarSweep, Scene, Track, Trajectory, VehiclePoints
from dwgs.scene.lidar import SURFACES
from dwgs.scene.moving import hits_in_box, is_there, moving_tracks
from dwgs.scene.pose import transform_points

GROUND_BAND = 0.1
"""The lowest part of a box [m] is road as often as tyre; its hits are left out."""
FEW_POINTS = 60
"""A track that has fewer is given the surface of its box as well."""
BOX_SPACING = 0.1
"""Between points on the surface of a box [m]."""

Hits = dict[str, NDArray[np.float64]]
"""Track id to the points [P, 3] that one sweep has of it, in the frame of its box [m]."""


def hits_on_movers(scene: Scene, sweep: LidarSweep) -> Hits:
    """What a sweep has of every track that ever moves."""
    candidates = np.isfinite(sweep.points.sum(1))
    if sweep.labels is not None:
        candidates &= ~np.isin(sweep.labels, [SURFACES.index("ground"), SURFACES.index("noise")])
    hits = {}
    for track in moving_tracks(scene, sweep.time):
        points = hits_in_box(sweep, track, candidates)[1]
        hits[track.id] = points[points[:, 2] > GROUND_BAND - track.size[2] / 2]
    return hits


def unmask(view: TrainingView, hits: Hits, trajectories: Mapping[str, Trajectory]) -> TrainingView:
    """The view with its traffic as it was recorded, and with the depths of that traffic.

    Where a generator repainted the image, the LiDAR saw something else: no depth is known there.
    """
    camera = view.camera
    carried = [transform_points(trajectories[id].at(camera.time), points) for id, points in hits.items()]
    points = np.concatenate([np.zeros((0, 3)), *carried])
    pixels, depths = depth_samples(points.astype(np.float32), camera)
    reactive = view.frame.reactive_mask
    known = view.hidden if reactive is None else view.hidden & ~reactive
    fresh = known[pixels[:, 0], pixels[:, 1]]
    return replace(
        view,
        pixels=view.frame.pixels,
        hidden=np.zeros_like(view.hidden),
        depth_pixels=np.concatenate([view.depth_pixels, pixels[fresh]]),
        depths=np.concatenate([view.depths, depths[fresh]]),
    )


def find_movers(scene: Scene, views: list[TrainingView], hits: Mapping[int, Hits]) -> dict[str, Insertion]:
    """Every track that moves and that a view shows, as if it had been inserted where it drove.

    Args:
        scene: The drive.
        views: Frames that teach, traffic not hidden.
        hits: What the sweep of each frame index has of each track.
    """
    movers = {}
    for track in scene.tracks:
        there = [view for view in views if track.is_moving and is_there(track.trajectory, view.camera.time)]
        seen = [view for view in there if len(_centre_in(view, track)[0])]
        if not seen:
            continue
        clouds = [_colored(view, track, hits.get(view.frame.index, {}).get(track.id)) for view in seen]
        if sum(len(points) for points, _ in clouds) < FEW_POINTS:
            nearest = min(seen, key=lambda view: float(_centre_in(view, track)[3][0]))
            clouds.append(_colored(nearest, track, box_surface(track.size, BOX_SPACING)))
        points, colors = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
        if len(points):
            vehicle = VehiclePoints(points.astype(np.float32), colors)
            movers[track.id] = Insertion(vehicle, track.size, track.trajectory, track.category)
    return movers


def box_surface(size: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Points [P, 3] about ``spacing`` [m] apart on all faces but the lowest of a box of that size."""
    points = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        counts = [max(2, round(size[k] / spacing)) for k in others]
        grid = np.meshgrid(*((np.arange(n) + 0.5) / n - 0.5 for n in counts), indexing="ij")
        for side in (-0.5, 0.5):
            face = np.full((grid[0].size, 3), side)
            face[:, others] = np.stack([g.ravel() for g in grid], 1)
            points.append(face)
    del points[4]
    return np.concatenate(points) * size


def _centre_in(view: TrainingView, track: Track):
    """What `pixels_of` says about the centre of the box."""
    centre = track.trajectory.at(view.camera.time)[None, :3, 3]
    return pixels_of(centre, view.camera)


def _colored(
    view: TrainingView, track: Track, points: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Those of a track's points [P, 3] that lie in the image, and the colours they have there."""
    if points is None or len(points) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    world = transform_points(track.trajectory.at(view.camera.time), points)
    index, rows, columns, _ = pixels_of(world, view.camera)
    return points[index], view.pixels[rows, columns]
