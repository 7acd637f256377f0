"""A car made of boxes, and one box that drives away."""

import numpy as np
import trimesh

from dwgs.scene import Trajectory, VehiclePoints
from dwgs.scene.pose import pose

LOOK_ALONG_X = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
SIZE = np.array([4.0, 1.8, 1.5])
FRAMES = 3


def box_points(size: np.ndarray, count: int = 4000) -> VehiclePoints:
    """A box whose rear (-x) is red and whose other sides are blue."""
    surface = trimesh.creation.box(extents=size)
    points, face = trimesh.sample.sample_surface(surface, count, seed=0)
    normals = surface.face_normals[face]
    colors = np.where(normals[:, :1] < -0.5, (200, 0, 0), (0, 0, 200))
    return VehiclePoints(points.astype(np.float32), colors.astype(np.uint8), normals.astype(np.float32), True)


def drive(x: float, y: float = 0.0, frames: int = FRAMES) -> Trajectory:
    """Away from the camera at 10 m/s, wheels on z = 0."""
    poses = [pose(np.eye(3), [x + i, y, SIZE[2] / 2]) for i in range(frames)]
    return Trajectory(np.arange(frames) * 0.1, np.stack(poses))


def toy_car() -> trimesh.Trimesh:
    """Metres, z up, forward +x: a low red bonnet in front of a blue cabin that hides a green seat."""
    parts = [
        trimesh.creation.box(bounds=[[-2.2, -0.9, 0.0], [2.2, 0.9, 0.8]]),
        trimesh.creation.box(bounds=[[-2.0, -0.8, 0.8], [0.6, 0.8, 1.5]]),
        trimesh.creation.box(bounds=[[-0.5, -0.3, 0.9], [0.0, 0.3, 1.3]]),
    ]
    for part, color in zip(parts, [(200, 0, 0), (0, 0, 200), (0, 200, 0)], strict=True):
        part.visual.face_colors = (*color, 255)
    return trimesh.util.concatenate(parts)
