"""The embedded street as a background of as many Gaussians as wanted: discs that cover its surfaces evenly, as seen."""

import numpy as np
import trimesh
from scipy.spatial import KDTree

from dwgs.scene import Background, Gaussians
from dwgs.splat.constants import SH_C0
from dwgs.street import Street
from dwgs.street.shape import Shape

COVERAGE, THINNESS, OPACITY = 0.6, 0.1, 0.9
"""Standard deviation of a disc in mean spacings; its thickness in the same; what closes a surface at that."""
NEAREST, FARTHEST = 4.0, 40.0
"""Between these distances from the drive [m] so many discs lie in a solid angle; nearer and farther, on an area."""
LONGEST, FIELDS = 4.0, 100.0
"""Edge of a triangle that has one density [m]; how far beside the road all is field and left out [m]."""
SKY = 0.7
"""Its grey."""


def cover(street: Street, count: int) -> Background:
    """All that stands still in the street, in its paint without light: as dense as ``count`` discs make it."""
    shape = Shape.join(list(street.stage.shapes[:2]))
    built = (np.abs(shape.corners[..., 1]) < FIELDS).all(1)
    corners, materials = shape.corners[built], shape.materials[built]
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    pieces = trimesh.remesh.subdivide_to_size(corners.reshape(-1, 3), faces, LONGEST, 20, return_index=True)
    mesh = trimesh.Trimesh(pieces[0], pieces[1], process=False)
    materials = materials[pieces[-1]]
    eyes = np.array([street.camera(i).position for i in range(street.frames)])
    densities = KDTree(eyes).query(mesh.triangles_center)[0].clip(NEAREST, FARTHEST) ** -2
    weights = mesh.area_faces * densities
    points, chosen = trimesh.sample.sample_surface(mesh, count, face_weight=weights, seed=street.seed)[:2]

    spacings = np.sqrt(weights.sum() / (count * densities))
    colors = street.plan.palette.colors()[materials] / np.float32(255)
    # The short way from z to a normal of either sign: a disc has two sides.
    x, y, z = (mesh.face_normals * np.where(mesh.face_normals[:, 2:] < 0, -1, 1)).T
    quats = np.stack([1 + z, -y, x, np.zeros_like(x)], 1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = COVERAGE * spacings[:, None] * (1, 1, THINNESS)
    sh = ((colors - np.float32(0.5)) / np.float32(SH_C0))[:, None]
    gaussians = Gaussians(
        points.astype(np.float32),
        quats.astype(np.float32)[chosen],
        scales.astype(np.float32)[chosen],
        np.full(count, OPACITY, np.float32),
        sh.astype(np.float32)[chosen],
    )
    return Background(gaussians, np.full((4, 8, 3), SKY, np.float32))
