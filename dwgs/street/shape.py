"""Triangles with a material each: what everything in the street is made of."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.pose import pose


@dataclass(frozen=True)
class Shape:
    """A soup of triangles: nothing is shared, so that hard and smooth edges can lie side by side."""

    corners: NDArray[np.float32]
    """[F, 3, 3] corner positions [m]."""
    normals: NDArray[np.float32]
    """[F, 3, 3] unit normals at the corners, outward."""
    materials: NDArray[np.int32]
    """[F] row of the `Palette` (or of a table that `painted` looks up)."""

    def __len__(self) -> int:
        return len(self.corners)

    @staticmethod
    def of(mesh: trimesh.Trimesh, material: int, smooth: bool = False) -> "Shape":
        """A mesh in one material, faceted or with the normals of its vertices."""
        normals = mesh.vertex_normals[mesh.faces] if smooth else mesh.face_normals[:, None].repeat(3, 1)
        return Shape(
            mesh.triangles.astype(np.float32),
            normals.astype(np.float32),
            np.full(len(mesh.faces), material, np.int32),
        )

    @staticmethod
    def join(shapes: "list[Shape]") -> "Shape":
        """All of them as one."""
        fields = ("corners", "normals", "materials")
        return Shape(*(np.concatenate([getattr(s, f) for s in shapes]) for f in fields))

    def moved(self, a_from_b: ArrayLike) -> "Shape":
        """The shape carried by a rigid transform [4, 4]."""
        a_from_b = np.asarray(a_from_b, np.float32)
        rotation = a_from_b[:3, :3].T
        return replace(self, corners=self.corners @ rotation + a_from_b[:3, 3], normals=self.normals @ rotation)

    def at(self, x: float, y: float, z: float = 0.0) -> "Shape":
        """The shape shifted [m]."""
        return self.moved(pose(np.eye(3), (x, y, z)))

    def painted(self, materials: ArrayLike) -> "Shape":
        """Each material replaced by what the table [M] says for it."""
        return replace(self, materials=np.asarray(materials, np.int32)[self.materials])

    @property
    def bounds(self) -> NDArray[np.float32]:
        """[2, 3] lowest and highest corner [m]."""
        points = self.corners.reshape(-1, 3)
        return np.stack([points.min(0), points.max(0)])


def box(low: ArrayLike, high: ArrayLike, material: int) -> Shape:
    """An axis-aligned box between two corners [3] [m]."""
    bounds = np.array([low, high], np.float64)
    return Shape.of(trimesh.creation.box(bounds=bounds), material)


def pole(radius: float, height: float, material: int, sections: int = 8) -> Shape:
    """An upright round pole on the ground [m]."""
    mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=sections)
    return Shape.of(mesh, material, smooth=True).at(0, 0, height / 2)


def ellipsoid(radii: ArrayLike, material: int, subdivisions: int = 2) -> Shape:
    """A round thing of three radii [3] [m] about the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    mesh.vertices *= np.asarray(radii)
    return Shape.of(mesh, material, smooth=True)


def grid_surface(points: NDArray, materials: NDArray) -> Shape:
    """A smooth surface through a grid of points [R, C, 3], one material per cell [R-1, C-1].

    The direction of the rows times (cross product) that of the columns points outward.
    """
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2).reshape(-1, 3)
    mesh = trimesh.Trimesh(points.reshape(-1, 3), faces, process=False)
    normals = mesh.vertex_normals[faces]
    doubled = np.repeat(materials.reshape(-1), 2).astype(np.int32)
    solid = mesh.area_faces > 1e-9
    return Shape(mesh.triangles[solid].astype(np.float32), normals[solid].astype(np.float32), doubled[solid])
