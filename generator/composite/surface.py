"""The surface of a vehicle as oriented, coloured discs: dense, closed, down to the ground."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.scene import VehiclePoints
from dwgs.scene.color import linear_from_srgb
from generator.composite.paint import paint
from generator.composite.solid import solid_from_scan

MAX_DISCS = 180_000
"""Discs on a vehicle at most: 1.4 cm apart on a car."""
SCAN_CELL = 0.016
"""Discs on a scan's solid lie so far apart [m]; it is smoother than that."""
WHITE = 0.8
"""Albedo of the whitest paint: textures draw it as 1."""
RUBBER = 0.03
"""What is darker than this near the ground is a tyre, and does not shine."""


@dataclass(frozen=True)
class Surface:
    """Discs in the vehicle frame: box centre, x forward, y left, z up."""

    points: NDArray[np.float32]
    """[N, 3] [m]."""
    normals: NDArray[np.float32]
    """[N, 3] unit, outward."""
    radii: NDArray[np.float32]
    """[N] half the distance to the ring of neighbours [m]."""
    colors: NDArray[np.float32]
    """[N, 3] linear light in [0, 1]: what a camera saw, or an albedo."""
    gloss: NDArray[np.float32]
    """[N] in [0, 1]: share of a clear coat's reflection to be added."""
    lit: NDArray[np.float32]
    """[N] in [0, 1]: how much of the colour comes from a camera and contains its light."""


def surface_of(vehicle: VehiclePoints, size: NDArray, seed: int = 0) -> Surface:
    """The whole surface of a vehicle of ``size`` [3] [m]; what its points do not cover is completed.

    A complete cloud with normals (a mesh) is taken as it is; any other is a scan: a solid that it paints.
    """
    if vehicle.is_complete and vehicle.normals is not None:
        return _of_mesh(vehicle, size)
    solid = solid_from_scan(vehicle.points, size)
    look = paint(solid, vehicle, size)
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    points, triangle = trimesh.sample.sample_surface(mesh, int(4 * mesh.area / SCAN_CELL**2), seed=seed)[:2]
    kept = _evenly(points, SCAN_CELL)
    points, triangle = points[kept], triangle[kept]
    shares = trimesh.triangles.points_to_barycentric(mesh.triangles[triangle], points)[..., None].clip(0, 1)
    corners = solid.faces[triangle]
    fields = (points, solid.normals, look.colors, look.gloss[:, None], look.evidence[:, None])
    values = [fields[0], *((f[corners] * shares).sum(1) for f in fields[1:])]
    points, normals, colors, gloss, lit = (v.astype(np.float32) for v in values)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-9)
    return Surface(points, normals, _radii(points), colors, gloss[:, 0], lit[:, 0])


def _of_mesh(vehicle: VehiclePoints, size: NDArray) -> Surface:
    assert vehicle.normals is not None
    cell, kept = 0.005, np.arange(len(vehicle.points))
    while len(kept) > MAX_DISCS:
        kept = _evenly(vehicle.points, cell)
        cell *= 1.1
    points, normals = vehicle.points[kept], vehicle.normals[kept]
    colors = np.float32(WHITE) * linear_from_srgb(vehicle.colors[kept] / np.float32(255))
    is_rubber = (points[:, 2] < -0.2 * size[2]) & (colors.max(1) < RUBBER)
    return Surface(points, normals, _radii(points), colors, np.float32(1) - is_rubber, np.zeros(len(kept), np.float32))


def _evenly(points: NDArray, cell: float) -> NDArray[np.int64]:
    """One of the points [P, 3] in each occupied cube of side ``cell`` [m]: unlike chance, this leaves no gaps."""
    cubes = np.floor((points - points.min(0)) / cell).astype(np.int64)
    shape = cubes.max(0) + 1
    return np.sort(np.unique(np.ravel_multi_index(tuple(cubes.T), tuple(shape)), return_index=True)[1])


def _radii(points: NDArray) -> NDArray[np.float32]:
    """Half the distance to the sixth neighbour [N], as in a hexagon; strays stay small."""
    distance = KDTree(points).query(points, min(7, len(points)), workers=2)[0].reshape(len(points), -1)[:, -1]
    return np.clip(0.5 * distance, 0.002, 3 * np.median(distance)).astype(np.float32)
