"""Which points of a mesh can be seen from outside, and from which side."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from generator.conditions import kernels

DIRECTIONS = 48
"""Viewpoints at infinity, spread evenly over the sky and down to `LOWEST`."""

LOWEST = -0.1
"""z of the lowest direction: nobody looks at a car from further below, but many could look in from there."""

PATCH = 0.1
"""Points of one face within a cube of this side [m] share their fate: few of them are asked."""

_ASKED = 3  # of a patch


def seen_from_outside(points: NDArray, face: NDArray[np.int64], triangles: NDArray) -> NDArray[np.int8]:
    """+1 [P] where the side from which corners turn left is seen, -1 where the other is, 0 where neither.

    Args:
        points: [P, 3] on the surface [m], z up.
        face: [P] the triangle that each point lies on.
        triangles: [F, 3, 3] corners of every face that hides [m].
    """
    cell = np.floor((points - points.min(0)) / PATCH).astype(np.int64)
    span = cell.max(0) + 1
    key = ((face * span[0] + cell[:, 0]) * span[1] + cell[:, 1]) * span[2] + cell[:, 2]
    _, patch, count = np.unique(key, return_inverse=True, return_counts=True)
    by_patch = np.argsort(patch, kind="stable")
    rank = np.arange(len(points)) - np.repeat(np.cumsum(count) - count, count)
    asked = by_patch[rank < _ASKED]
    corners = triangles[face[asked]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-30)
    sides = _look(points[asked], normals, triangles)
    votes = np.zeros(len(count), np.int64)
    np.add.at(votes, patch[asked], sides)
    return votes.clip(-1, 1).astype(np.int8)[patch]


def _look(points: NDArray, normals: NDArray, triangles: NDArray) -> NDArray[np.int8]:
    mesh = wp.Mesh(
        points=_vectors(triangles.reshape(-1, 3)),
        indices=wp.array(np.arange(3 * len(triangles), dtype=np.int32), device="cpu"),
    )
    side = wp.zeros(len(points), dtype=wp.int8, device="cpu")
    inputs = [mesh.id, _vectors(points), _vectors(normals), _vectors(_directions()), side]
    wp.launch(kernels.look_from_outside, dim=len(points), inputs=inputs, device="cpu")
    return np.asarray(side.numpy(), np.int8)


def _vectors(array: NDArray) -> wp.array:
    return wp.array(np.ascontiguousarray(array, np.float32), dtype=wp.vec3, device="cpu")


def _directions() -> NDArray[np.float64]:
    """[D, 3] towards the viewpoints: a Fibonacci lattice, in an order that looks everywhere early."""
    index = np.arange(DIRECTIONS) + 0.5
    z = LOWEST + (1 - LOWEST) * index / DIRECTIONS
    angle = np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - z * z)
    lattice = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], 1)
    return lattice[np.argsort(np.arange(DIRECTIONS) * 0.6180339887498949 % 1)]
