"""The street on the device: meshes with their trees of boxes, the palette, and who moves."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.pose import quat_from_rotation
from dwgs.scene.trajectory import Trajectory
from dwgs.street.material import Palette
from dwgs.street.raycast import Body, World
from dwgs.street.shape import Shape


@dataclass(frozen=True)
class Vehicle:
    """A car on the road: moving ones are bodies of their own, parked ones belong to the still world."""

    shape: Shape
    """In its own frame."""
    size: tuple[float, float, float]
    """(length, width, height) of its box [m]."""
    trajectory: Trajectory
    """Pose of the box centre."""


@dataclass(frozen=True)
class Stage:
    """A still world and the vehicles that move in it, ready for rays."""

    world: World
    """What kernels read."""
    shapes: tuple[Shape, ...]
    """The still world, then the movers."""
    meshes: tuple[wp.Mesh, ...]
    """Of the shapes; kernels know them by number only, so they are kept alive here."""
    parked: tuple[Vehicle, ...]
    """Vehicles within the still world: they keep skylight from the ground."""
    movers: tuple[Vehicle, ...]
    """Body 1 and on."""

    def with_mover(self, vehicle: Vehicle) -> "Stage":
        """The same street with one vehicle more, as the last body."""
        shapes, meshes = (*self.shapes, vehicle.shape), (*self.meshes, _mesh(vehicle.shape))
        world = _world(shapes, meshes)
        world.looks, world.sun, world.seed = self.world.looks, self.world.sun, self.world.seed
        return Stage(world, shapes, meshes, self.parked, (*self.movers, vehicle))

    def poses(self, times: ArrayLike) -> wp.array:
        """Poses of the bodies [bodies, moments] at the given times [s]; the first stands at the origin."""
        times = np.atleast_1d(np.asarray(times, np.float64))
        still = np.broadcast_to(np.eye(4), (len(times), 4, 4))
        return transforms(np.stack([still, *(m.trajectory.at(times) for m in self.movers)]))

    def contacts(self, time: float) -> tuple[wp.array, wp.array]:
        """Poses and half sizes [m] of all vehicles at a time [s]."""
        vehicles = self.parked + self.movers
        poses = [v.trajectory.at(time) for v in vehicles]
        halves = [np.asarray(v.size) / 2 for v in vehicles]
        return transforms(np.reshape(poses, (-1, 4, 4))), _vectors(np.reshape(halves, (-1, 3)))


def build_stage(
    still: Shape,
    parked: tuple[Vehicle, ...],
    movers: tuple[Vehicle, ...],
    palette: Palette,
    sun: NDArray,
    seed: int,
) -> Stage:
    """Puts the street on the device; ``sun`` [3] points to the sun."""
    cars = [v.shape.moved(v.trajectory.at(0.0)) for v in parked]
    shapes = (Shape.join([still, *cars]), *(m.shape for m in movers))
    meshes = tuple(_mesh(shape) for shape in shapes)
    world = _world(shapes, meshes)
    world.looks, world.sun, world.seed = palette.looks(), wp.vec3(*sun), wp.uint32(seed)
    return Stage(world, shapes, meshes, parked, movers)


def transforms(a_from_b: NDArray) -> wp.array:
    """Rigid transforms [..., 4, 4] as kernels read them."""
    quats = np.roll(quat_from_rotation(a_from_b[..., :3, :3]), -1, -1)
    rows = np.concatenate([a_from_b[..., :3, 3], quats], -1).astype(np.float32)
    return wp.array(rows, dtype=wp.transform, device="cpu")


def in_chunks(run: Callable[[int, int], None], rows: int, size: int, executor: Executor | None) -> None:
    """Calls ``run(first, count)`` over all rows: at once, or in pieces on the threads of an executor."""
    if executor is None:
        run(0, rows)
        return
    for job in [executor.submit(run, first, min(size, rows - first)) for first in range(0, rows, size)]:
        job.result()


def _mesh(shape: Shape) -> wp.Mesh:
    indices = wp.array(np.arange(3 * len(shape), dtype=np.int32), dtype=int, device="cpu")
    return wp.Mesh(_vectors(shape.corners), indices, bvh_constructor="sah")


def _world(shapes: tuple[Shape, ...], meshes: tuple[wp.Mesh, ...]) -> World:
    bodies, first_face = [], 0
    for shape, mesh in zip(shapes, meshes, strict=True):
        body = Body()
        low, high = shape.bounds
        body.mesh, body.first_face = mesh.id, first_face
        body.low, body.high = wp.vec3(*(low - 0.01)), wp.vec3(*(high + 0.01))
        bodies.append(body)
        first_face += len(shape)
    world = World()
    world.bodies = wp.array(bodies, dtype=Body, device="cpu")
    world.corner_normals = _vectors(np.concatenate([s.normals for s in shapes]))
    world.look_of_face = wp.array(np.concatenate([s.materials for s in shapes]), dtype=int, device="cpu")
    return world


def _vectors(rows: NDArray) -> wp.array:
    return wp.array(np.ascontiguousarray(rows, np.float32).reshape(-1, 3), dtype=wp.vec3, device="cpu")
