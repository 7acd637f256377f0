"""A recorded vehicle as coloured points: what the LiDAR hit of it, gathered in its own frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera, InputError, LidarSweep, Scene, Track, VehiclePoints
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import inverse, transform_points

GROUND_BAND = 0.12
"""The lowest part of the box [m] is road as often as tyre; it is left out."""

VOXEL = 0.02
"""One point is kept in each cube of this side [m]: the one seen from nearest by."""

LEAST_POINTS = 100
"""Fewer coloured points do not make a vehicle."""

WINDOW = 10
"""Sweeps before and after: 2 s of a 10 Hz drive, as in StreetCrafter."""

SIMULTANEOUS = 0.15
"""An image colours points that were hit within so much of its exposure [s]."""

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


def points_of_track(scene: Scene, track: Track, window: int | None = None) -> tuple[VehiclePoints, NDArray[np.float64]]:
    """The LiDAR points on a recorded vehicle in its own frame, coloured by the cameras, and its size [3] [m].

    Each point is carried into the box as the box stood when it was hit, then to where the box stood when the
    image was taken: a moving vehicle is neither smeared nor coloured by the road behind it.

    Args:
        scene: The recording, with sweeps.
        track: One of its tracks.
        window: Use only so many frames before and after the sweep that says most about it; None uses all.

    Raises:
        InputError: Too few points lie on it or no camera sees them.
    """
    hits = {sweep.frame_index: _hits(scene, track, sweep) for sweep in scene.sweeps}
    if window is not None and hits:
        best = max(hits, key=lambda index: len(hits[index].points))
        hits = {index: h for index, h in hits.items() if abs(index - best) <= window}
    points = np.concatenate([h.points for h in hits.values()] or [np.zeros((0, 3))])
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"a vehicle takes at least {LEAST_POINTS} LiDAR points that a camera saw, track {track.id} "
            f"has {len(points)}; choose another track, more cameras or more frames"
        )
    colors = np.concatenate([h.colors for h in hits.values()])
    depths = np.concatenate([h.depths for h in hits.values()])
    nearest_first = np.argsort(depths, kind="stable")
    voxels = np.floor(points[nearest_first] / VOXEL).astype(np.int64)
    _, first = np.unique(voxels, axis=0, return_index=True)
    kept = nearest_first[first]
    return VehiclePoints(points[kept].astype(np.float32), colors[kept]), track.size.copy()


def _in_box(sweep: LidarSweep, track: Track) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points [P, 3] inside the track's box, in the vehicle's frame, and when they were hit [P]."""
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


def _hits(scene: Scene, track: Track, sweep: LidarSweep) -> _Hits:
    """What the sweep hit and some camera sees, each point with its pixel in the image nearest in time."""
    points, times = _in_box(sweep, track)
    colors, depths = np.zeros((len(points), 3), np.uint8), np.zeros(len(points))
    gap = np.full(len(points), np.inf)
    for frames in scene.frames.values() if len(points) else ():
        exposures = np.array([frame.camera.time for frame in frames])
        frame = frames[int(np.argmin(np.abs(exposures - np.median(times))))]
        world_from_vehicle = track.trajectory.at(frame.camera.time)
        pixels, depth = frame.camera.project(transform_points(world_from_vehicle, points))
        late = np.abs(times - frame.camera.time)
        seen = (depth > 0) & frame.camera.contains(pixels) & (late < gap) & (late < SIMULTANEOUS)
        if seen.any():
            between = _between(sweep, frame.camera.position, world_from_vehicle[:3, 3], track.size)
            seen[seen] = ~_is_hidden(frame.camera, between, pixels[seen], depth[seen])
        if not seen.any():
            continue
        column, row = pixels[seen].astype(np.int64).T
        colors[seen] = frame.pixels[row, column]
        depths[seen], gap[seen] = depth[seen], late[seen]
    seen = np.isfinite(gap)
    return _Hits(points[seen], colors[seen], depths[seen])


def _between(sweep: LidarSweep, eye: NDArray, center: NDArray, size: NDArray) -> NDArray[np.float32]:
    """Points [P, 3] of the sweep that may hide a box from an eye: those in the tube between the two."""
    radius, distance = np.linalg.norm(size) / 2, np.linalg.norm(center - eye)
    offset = sweep.points - eye.astype(np.float32)
    along = offset @ ((center - eye) / distance).astype(np.float32)
    aside = np.einsum("pi,pi->p", offset, offset) - along * along
    return sweep.points[(along > 0) & (along < distance + radius) & (aside < radius**2)]


def _is_hidden(camera: Camera, others: NDArray, pixels: NDArray, depth: NDArray) -> NDArray[np.bool_]:
    """Whether one of the others is in front of each point [P], at the resolution that a sweep has."""
    cell = camera.width / _OCCLUSION_CELLS
    others, other_depth = camera.project(others)
    ahead = (other_depth > 0) & camera.contains(others)
    nearest = np.full((int(camera.height / cell) + 1, int(camera.width / cell) + 1), np.inf)
    column, row = (others[ahead] / cell).astype(np.int64).T
    np.minimum.at(nearest, (row, column), other_depth[ahead])
    column, row = (pixels / cell).astype(np.int64).T
    return nearest[row, column] < depth - _OCCLUSION_SLACK
