"""The street on the device: meshes with their trees of boxes, the palette, and who moves."""

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

    def at(self, times: ArrayLike) -> World:
        """The world with everyone where they are at the given times [s], in the order of moments."""
        times = np.atleast_1d(np.asarray(times, np.float64))
        still = np.broadcast_to(np.eye(4), (len(times), 4, 4))
        vehicles = self.parked + self.movers
        contacts = [v.trajectory.at(times[0]) for v in vehicles]
        world = _renewed(self.world)
        world.poses = transforms(np.stack([still, *(m.trajectory.at(times) for m in self.movers)]))
        world.contacts = transforms(np.reshape(contacts, (-1, 4, 4)))
        world.halves = _vectors(np.reshape([v.size for v in vehicles], (-1, 3)) / 2)
        return world


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


def _mesh(shape: Shape) -> wp.Mesh:
    indices = wp.array(np.arange(3 * len(shape), dtype=np.int32), dtype=int, device="cpu")
    return wp.Mesh(_vectors(shape.corners), indices, bvh_constructor="sah")


def _world(shapes: tuple[Shape, ...], meshes: tuple[wp.Mesh, ...]) -> World:
    bodies, first_face = [], 0
    for shape, mesh in zip(shapes, meshes, strict=True):
        body = Body()
        body.mesh, body.first_face = mesh.id, first_face
        body.radius = float(np.linalg.norm(shape.corners, axis=-1).max()) + 0.01
        bodies.append(body)
        first_face += len(shape)
    world = World()
    world.bodies = wp.array(bodies, dtype=Body, device="cpu")
    world.corner_normals = _vectors(np.concatenate([s.normals for s in shapes]))
    world.look_of_face = wp.array(np.concatenate([s.materials for s in shapes]), dtype=int, device="cpu")
    return world


def _vectors(rows: NDArray) -> wp.array:
    return wp.array(np.ascontiguousarray(rows, np.float32).reshape(-1, 3), dtype=wp.vec3, device="cpu")


def _renewed(world: World) -> World:
    """The same arrays in another struct, so that threads can point theirs at different moments."""
    other = World()
    for name in ("bodies", "corner_normals", "look_of_face", "looks", "sun", "seed"):
        setattr(other, name, getattr(world, name))
    return other
