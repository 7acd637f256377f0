"""What the recording holds nearer than something: sparse LiDAR, carried to every pixel up to image edges."""

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, binary_opening, gaussian_filter
from scipy.spatial import KDTree

from dwgs.scene import Camera, LidarSweep, Scene, Track
from dwgs.scene.pose import inverse, transform_points

WINDOW = 2
"""Sweeps so many frames before and after are used as well: four times as dense, still the same place."""
MARGIN = 0.3
"""Nearer by less than this [m] is the same place: LiDAR noise, the roundness of bodies."""
NEAR = 80.0
"""Vehicles further than this [m] from the LiDAR hide nothing that is inserted."""
GROWN = np.array([0.15, 0.15, 0.05])
"""A point this far [m] outside a recorded box still lies on its vehicle: boxes are drawn by hand."""
NEIGHBOURS = 6
"""LiDAR points that vote for a pixel."""
FAR = 16.0
"""A vote is heard so far [px]."""
EDGE = 0.8
"""Occluders end over about this distance [px], as everything does that a lens draws."""
COLOR_SCALE = 60.0
"""A difference of colour from 0 to 1 counts like this many pixels: votes stop at edges."""
CLEARANCE = 0.25
"""Returns lower than this above the vehicle's ground [m] are ground, and hide nothing."""


@dataclass(frozen=True)
class Returns:
    """LiDAR points, and which recorded vehicle each lies on."""

    points: NDArray[np.float32]
    """[P, 3] [m]."""
    track: NDArray[np.int64]
    """[P] index into `Recording.tracks`, or -1."""


@dataclass(frozen=True)
class _Sorted:
    """One sweep, vehicle by vehicle."""

    still: Returns
    """What does not move, world frame."""
    moving: dict[int, NDArray[np.float32]]
    """Points [P, 3] on each moving vehicle, in the frame of its box."""


class Recording:
    """The sweeps of a scene; each is sorted by vehicle when it is first asked for."""

    def __init__(self, scene: Scene) -> None:
        self.tracks = [t for t in scene.tracks if t.is_vehicle]
        self._sweeps = {sweep.frame_index: sweep for sweep in scene.sweeps}
        self._sorted: dict[int, _Sorted] = {}
        self._sorting = threading.Lock()

    def at(self, camera: Camera, frame_index: int) -> Returns:
        """What a camera has before it when it exposes, world frame; its image may be a small window.

        Sweeps within `WINDOW` frames count; points on moving vehicles are carried to the camera's time.
        """
        near = [i for i in range(frame_index - WINDOW, frame_index + WINDOW + 1) if i in self._sweeps]
        with self._sorting:
            for i in near:
                if i not in self._sorted:
                    self._sorted[i] = _sort(self.tracks, self._sweeps[i])
            for i in [i for i in self._sorted if abs(i - frame_index) > 2 * WINDOW]:
                del self._sorted[i]
            window = {i: self._sorted[i] for i in near}
        project = (camera.K @ camera.camera_from_world[:3]).astype(np.float32)
        found = [Returns(np.zeros((0, 3), np.float32), np.zeros(0, np.int64))]
        found += [_in_view(window[i].still, project, camera) for i in near]
        for number in sorted({number for i in near for number in window[i].moving}):
            points = np.concatenate([window[i].moving[number] for i in near if number in window[i].moving])
            world = transform_points(self.tracks[number].trajectory.at(camera.time), points).astype(np.float32)
            found.append(_in_view(Returns(world, np.full(len(world), number)), project, camera))
        return Returns(np.concatenate([r.points for r in found]), np.concatenate([r.track for r in found]))

    def ranges(self, camera: Camera) -> NDArray[np.float64]:
        """How far [T] the vehicles are from a camera when it exposes [m]."""
        centers = np.array([_center(t, camera.time) for t in self.tracks]).reshape(-1, 3)
        return np.linalg.norm(centers - camera.position, axis=1)

    def hides(
        self, camera: Camera, frame_index: int, pose: NDArray, size: NDArray, image: NDArray, depth: NDArray
    ) -> NDArray[np.float32]:
        """How much of each pixel [h, w] shows something recorded before a vehicle.

        Args:
            camera: Of a window of a recorded frame.
            frame_index: Of that frame.
            pose: [4, 4] of the vehicle's box centre in the world.
            size: [3] of the box [m].
            image: [h, w, 3] recorded, in [0, 1].
            depth: [h, w] of the vehicle and its shadow [m], infinite elsewhere.
        """
        if not np.isfinite(depth).any():
            return np.zeros(depth.shape, np.float32)
        returns = self.at(camera, frame_index)
        above = transform_points(inverse(pose), returns.points)[:, 2] > CLEARANCE - size[2] / 2
        is_before = self.ranges(camera) < np.linalg.norm(pose[:3, 3] - camera.position)
        hides = above & (np.append(is_before, True)[returns.track])  # a track of -1 takes the last
        return nearer(returns, camera, image, depth, hides)


def _in_view(returns: Returns, project: NDArray, camera: Camera) -> Returns:
    u, v, z = project[:, :3] @ returns.points.T + project[:, 3:]
    kept = np.flatnonzero((z > 0.5) & (u >= 0) & (u < camera.width * z) & (v >= 0) & (v < camera.height * z))
    return Returns(returns.points[kept], returns.track[kept])


def _center(track: Track, time: float) -> NDArray[np.float64]:
    times, poses = track.trajectory.times, track.trajectory.world_from_vehicle
    return np.array([np.interp(time, times, poses[:, k, 3]) for k in range(3)])


def _sort(tracks: list[Track], sweep: LidarSweep) -> _Sorted:
    """Assign a sweep's points to the vehicles they lie on, at the time the sweep passed them."""
    order = np.argsort(sweep.points[:, 0])
    points, times = sweep.points[order], sweep.times[order]
    owner, moving = np.full(len(points), -1), {}
    for number, track in enumerate(tracks):
        center, radius = _center(track, sweep.time), np.linalg.norm(track.size) / 2 + 2
        if not track.trajectory.covers(sweep.time) or np.linalg.norm(center - sweep.origin) > NEAR:
            continue
        near = slice(*np.searchsorted(points[:, 0], (center[0] - radius, center[0] + radius)))
        close = np.flatnonzero((np.abs(points[near] - center) < radius).all(1)) + near.start
        if len(close) == 0:
            continue
        box_from_world = inverse(track.trajectory.at(float(np.median(times[close]))))
        local = transform_points(box_from_world, points[close])
        inside = (np.abs(local) < track.size / 2 + GROWN).all(1)
        owner[close[inside]] = number
        if track.is_moving and inside.any():
            moving[number] = local[inside].astype(np.float32)
    still = ~np.isin(owner, list(moving))
    return _Sorted(Returns(points[still], owner[still]), moving)


def nearer(
    returns: Returns, camera: Camera, image: NDArray, depth: NDArray, hides: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """How much of each pixel [H, W], in [0, 1], shows something recorded nearer than ``depth`` [H, W] [m].

    Args:
        returns: LiDAR in view of the camera, at its time.
        camera: Of the image.
        image: [H, W, 3] recorded, in [0, 1].
        depth: What is asked about; infinite where nothing is.
        hides: [P] returns that hide what is behind them; the others vote that nothing does.
    """
    hidden = np.zeros(depth.shape, np.float32)
    uv, z = camera.project(returns.points)
    column, row = np.clip(uv.astype(int), 0, (camera.width - 1, camera.height - 1)).T
    asked = depth[row, column]
    votes = hides & np.isfinite(asked) & ((returns.track >= 0) | (z < asked - MARGIN))
    if not votes.any():
        return hidden
    rows, columns = np.nonzero(np.isfinite(depth))
    samples = np.concatenate([uv, COLOR_SCALE * image[row, column]], 1)
    pixels = np.concatenate([np.stack([columns, rows], 1) + 0.5, COLOR_SCALE * image[rows, columns]], 1)
    count = min(NEIGHBOURS, len(samples))
    distance, index = KDTree(samples).query(pixels, count, distance_upper_bound=FAR)
    distance, index = distance.reshape(len(pixels), count), index.reshape(len(pixels), count)
    weight = 1 / (distance + 1)  # none for a neighbour too far to be found
    share = (weight * np.append(votes, False)[index]).sum(1) / np.maximum(weight.sum(1), 1e-9)
    hidden[rows, columns] = share
    asked_here = np.isfinite(depth)
    # a speck is a stray return; a hole is a window, which returns what lies behind it
    solid = binary_opening((hidden > 0.5) | ~asked_here, iterations=2, border_value=1)
    solid = np.asarray(binary_fill_holes(solid & asked_here), np.float32)
    weight = np.maximum(gaussian_filter(asked_here.astype(np.float32), EDGE), 1e-3)
    return (asked_here * gaussian_filter(solid, EDGE) / weight).astype(np.float32)
