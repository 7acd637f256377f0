"""Which points of a mesh can be seen from outside, and from which side."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

DIRECTIONS = 48
"""Viewpoints at infinity, spread evenly over the sky and down to `LOWEST`."""

LOWEST = -0.15
"""z of the lowest direction: nobody looks at a car from further below, but many could look in from there."""

wp.config.log_level = wp.LOG_ERROR  # standard output belongs to the command line


def seen_from_outside(points: NDArray, normals: NDArray, triangles: NDArray) -> NDArray[np.int8]:
    """+1 where the side that the normal faces can be seen [P], -1 where only the other can, 0 where neither can.

    Args:
        points: [P, 3] on the surface [m], z up.
        normals: [P, 3] unit.
        triangles: [F, 3, 3] corners of every face that hides [m].
    """
    mesh = wp.Mesh(
        points=wp.array(
            np.ascontiguousarray(triangles.reshape(-1, 3), np.float32), dtype=wp.vec3, device="cpu"
        ),
        indices=wp.array(np.arange(3 * len(triangles), dtype=np.int32), device="cpu"),
    )
    side = wp.zeros(len(points), dtype=wp.int8, device="cpu")
    wp.launch(
        _look,
        dim=len(points),
        inputs=[
            mesh.id,
            wp.array(points.astype(np.float32), dtype=wp.vec3, device="cpu"),
            wp.array(normals.astype(np.float32), dtype=wp.vec3, device="cpu"),
            wp.array(_directions().astype(np.float32), dtype=wp.vec3, device="cpu"),
            side,
        ],
        device="cpu",
    )
    return side.numpy()


def _directions() -> NDArray[np.float64]:
    """[D, 3] towards the viewpoints: a Fibonacci lattice, in an order that looks everywhere early."""
    index = np.arange(DIRECTIONS) + 0.5
    z = LOWEST + (1 - LOWEST) * index / DIRECTIONS
    angle = np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - z * z)
    lattice = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], 1)
    return lattice[np.argsort(np.arange(DIRECTIONS) * 0.6180339887498949 % 1)]


@wp.kernel
def _look(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    side: wp.array(dtype=wp.int8),
):
    i = wp.tid()
    found = int(0)
    for k in range(directions.shape[0]):
        facing = wp.dot(normals[i], directions[k])
        # along the surface rays slip between neighbouring faces
        if wp.abs(facing) > 0.1 and found < 1:
            sign = wp.sign(facing)
            if found == 0 or sign > 0.0:
                start = points[i] + 1.0e-3 * sign * normals[i]
                if not wp.mesh_query_ray_anyhit(mesh, start, directions[k], 100.0):
                    found = int(sign)
    side[i] = wp.int8(found)
