"""A recorded vehicle as coloured points: what the LiDAR hit of it, gathered in its own frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Frame, InputError, LidarSweep, Scene, Track, VehiclePoints
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import inverse, transform_points

GROUND_BAND = 0.12
"""The lowest part of the box [m] is road as often as tyre; it is left out."""

VOXEL = 0.02
"""One point is kept in each cube of this side [m]: the one seen from nearest by."""

LEAST_POINTS = 100
"""Fewer coloured points do not make a vehicle."""

_OF_VEHICLES = np.isin(SURFACES, ["unknown", "vehicle"])
_OCCLUSION_CELLS = 240  # of the depth test across an image: about as fine as a sweep is dense
_OCCLUSION_SLACK = 0.5  # m: nearer neighbours closer than this lie on the same thing


@dataclass(frozen=True)
class _Hits:
    points: NDArray[np.float64]
    """[P, 3] in the vehicle's frame."""
    colors: NDArray[np.uint8]
    """[P, 3]."""
    depths: NDArray[np.float64]
    """[P] from the camera that saw them."""


def points_of_track(
    scene: Scene, track: Track, window: int | None = None
) -> tuple[VehiclePoints, NDArray[np.float64]]:
    """The LiDAR points on a recorded vehicle in its own frame, coloured by the cameras, and its size [3] [m].

    Each point is carried into the box as the box stood when it was hit, then to where the box stood when the image
    was taken: a moving vehicle is neither smeared nor coloured by the road behind it.

    Args:
        scene: The recording, with sweeps.
        track: One of its tracks.
        window: Use only so many frames before and after the sweep that hits it most; None uses all.

    Raises:
        InputError: Too few points lie on it or no camera sees them.
    """
    found = [(sweep, *_hits_in_box(sweep, track)) for sweep in scene.sweeps]
    found = [(sweep, points, times) for sweep, points, times in found if len(points)]
    if window is not None and found:
        best = max(found, key=lambda hit: len(hit[1]))[0].frame_index
        found = [hit for hit in found if abs(hit[0].frame_index - best) <= window]
    hits = [_colored(scene, track, sweep, points, times) for sweep, points, times in found]
    points = np.concatenate([h.points for h in hits] or [np.zeros((0, 3))])
    if len(points) < LEAST_POINTS:
        lidar = sum(len(p) for _, p, _ in found)
        raise InputError(
            f"a vehicle takes at least {LEAST_POINTS} coloured LiDAR points, track {track.id} has {len(points)} "
            f"({lidar} hit it, the others no camera saw); choose another track, more cameras or more frames"
        )
    colors, depths = np.concatenate([h.colors for h in hits]), np.concatenate([h.depths for h in hits])
    nearest_first = np.argsort(depths, kind="stable")
    voxels = np.floor(points[nearest_first] / VOXEL).astype(np.int64)
    _, first = np.unique(voxels, axis=0, return_index=True)
    kept = nearest_first[first]
    return VehiclePoints(points[kept].astype(np.float32), colors[kept]), track.size.copy()


def _hits_in_box(sweep: LidarSweep, track: Track) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points [P, 3] of the sweep inside the track's box, in the vehicle's frame, and when they were hit [P]."""
    reach = np.linalg.norm(track.size) / 2 + 5.0  # m: how far it drives during a sweep, too
    center = track.trajectory.at(sweep.time)[:3, 3]
    candidates = (np.abs(sweep.points - center) < reach).all(1) & track.trajectory.covers(sweep.times)
    if sweep.labels is not None:
        candidates &= _OF_VEHICLES[sweep.labels]
    times = sweep.times[candidates]
    vehicle_from_world = inverse(track.trajectory.at(times))
    world = sweep.points[candidates].astype(np.float64)
    points = np.einsum("pij,pj->pi", vehicle_from_world[:, :3, :3], world) + vehicle_from_world[:, :3, 3]
    inside = (np.abs(points) <= track.size / 2).all(1) & (points[:, 2] > GROUND_BAND - track.size[2] / 2)
    return points[inside], times[inside]


def _colored(
    scene: Scene, track: Track, sweep: LidarSweep, points: NDArray[np.float64], times: NDArray[np.float64]
) -> _Hits:
    """The points that some camera sees, each with its pixel in the image nearest in time."""
    colors, depths = np.zeros((len(points), 3), np.uint8), np.zeros(len(points))
    gap = np.full(len(points), np.inf)
    for frames in scene.frames.values():
        exposures = np.array([frame.camera.time for frame in frames])
        frame = frames[int(np.argmin(np.abs(exposures - np.median(times))))]
        pixels, depth = frame.camera.project(transform_points(track.trajectory.at(frame.camera.time), points))
        late = np.abs(times - frame.camera.time)
        size = (frame.camera.width, frame.camera.height)
        seen = (depth > 0) & (pixels >= 0).all(1) & (pixels < size).all(1) & (late < gap)
        seen[seen] &= ~_is_hidden(frame, sweep, pixels[seen], depth[seen])
        if not seen.any():
            continue
        column, row = pixels[seen].astype(np.int64).T
        colors[seen] = frame.pixels[row, column]
        depths[seen], gap[seen] = depth[seen], late[seen]
    seen = np.isfinite(gap)
    return _Hits(points[seen], colors[seen], depths[seen])


def _is_hidden(frame: Frame, sweep: LidarSweep, pixels: NDArray, depth: NDArray) -> NDArray[np.bool_]:
    """Whether a sweep has something nearer [P] in front of each point, at the resolution that a sweep has."""
    camera = frame.camera
    cell = camera.width / _OCCLUSION_CELLS
    others, other_depth = camera.project(sweep.points)
    ahead = (other_depth > 0) & (others >= 0).all(1) & (others < (camera.width, camera.height)).all(1)
    nearest = np.full((int(camera.height / cell) + 1, int(camera.width / cell) + 1), np.inf)
    column, row = (others[ahead] / cell).astype(np.int64).T
    np.minimum.at(nearest, (row, column), other_depth[ahead])
    column, row = (pixels / cell).astype(np.int64).T
    return nearest[row, column] < depth - _OCCLUSION_SLACK
