"""What the LiDAR says about the street itself."""

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.reconstruct.moving_mask import BODY_MARGIN, moving_tracks
from dwgs.scene import Camera, LidarSweep, Scene, Track
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import inverse

FLEETING = [SURFACES.index("person"), SURFACES.index("noise")]
"""Labels of points that are not there in the next frame."""
NEAREST = 0.5
"""Nothing is seen nearer to a camera than this [m]."""
OCCLUSION_CELL = 4
"""Hits are compared within cells of so many pixels: the LiDAR looks over what hides a hit from the camera."""
OCCLUSION_RATIO = 1.15
"""A hit this many times farther than the nearest one of its cell is taken for hidden."""


def static_points(scene: Scene, sweep: LidarSweep) -> NDArray[np.float32]:
    """Points [P, 3] of a sweep in the world that lie on nothing that moves."""
    kept = np.isfinite(sweep.points.sum(1))
    if sweep.labels is not None:
        kept &= ~np.isin(sweep.labels, FLEETING)
    for track in moving_tracks(scene, sweep.time):
        kept[hits_in_box(sweep, track, kept)[0]] = False
    return sweep.points[kept]


def hits_in_box(
    sweep: LidarSweep, track: Track, candidates: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which of the ``candidates`` [P] of a sweep lie in a track's box, each at its own time, and where in its frame.

    The box is grown by `BODY_MARGIN`; indices [I], points [I, 3] [m].
    """
    half = track.size / 2 + BODY_MARGIN
    # A moving box sweeps over several metres in one turn: each point meets it at its own time.
    reach = np.linalg.norm(half) + 3.0
    centre = track.trajectory.at(sweep.time)[:3, 3]
    x, y = np.abs(sweep.points[:, :2].T - centre[:2, None])
    near = np.flatnonzero(candidates & (x < reach) & (y < reach))
    box_from_world = inverse(track.trajectory.at(sweep.times[near]))
    local = (box_from_world[:, :3, :3] @ sweep.points[near, :, None])[..., 0] + box_from_world[:, :3, 3]
    inside = (np.abs(local) < half).all(1)
    return near[inside], local[inside]


def pixels_of(
    points: NDArray[np.floating], camera: Camera
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Which of the world ``points`` [P, 3] the image holds: indices, rows, columns, depths [m], each [I]."""
    K_from_world = torch.from_numpy((camera.K @ camera.camera_from_world[:3]).astype(np.float32))
    p = torch.from_numpy(points).float() @ K_from_world[:, :3].T + K_from_world[:, 3]
    x, y, depth = p.unbind(1)
    inside = (depth > NEAREST) & (x >= 0) & (x < camera.width * depth) & (y >= 0) & (y < camera.height * depth)
    index = inside.nonzero()[:, 0]
    x, y, depth = p[index].unbind(1)
    columns = (x / depth).long().clamp(0, camera.width - 1)
    rows = (y / depth).long().clamp(0, camera.height - 1)
    return index.numpy(), rows.numpy(), columns.numpy(), depth.numpy()


def depth_samples(points: NDArray[np.float32], camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Pixels [S, 2] (row, column) with the depths [S] [m] that world ``points`` [P, 3] give them.

    One sample for a pixel, the nearest; none where a neighbour is much nearer.
    """
    _, rows, columns, depths = pixels_of(points, camera)
    order = np.argsort(depths, kind="stable")
    _, first = np.unique(rows[order] * camera.width + columns[order], return_index=True)
    nearest = order[first]
    rows, columns, depths = rows[nearest], columns[nearest], depths[nearest]
    floor = np.full((camera.height // OCCLUSION_CELL + 1, camera.width // OCCLUSION_CELL + 1), np.inf, np.float32)
    cell = rows // OCCLUSION_CELL, columns // OCCLUSION_CELL
    np.minimum.at(floor, cell, depths)
    visible = depths < OCCLUSION_RATIO * floor[cell]
    return np.stack([rows, columns], 1)[visible], depths[visible]
