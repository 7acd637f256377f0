"""The street on the device: meshes with their trees of boxes, the palette, and who moves."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.pose import quat_from_rotation
from dwgs.street.plan import Plan, Vehicle
from dwgs.street.raycast import Body, World
from dwgs.street.shape import Shape

CONTACT_REACH = 80.0
"""Further from the eye [m] a vehicle's dimming of the skylight under it is less than a pixel."""


@dataclass(frozen=True)
class Stage:
    """A still world and the vehicles that move in it, ready for rays."""

    world: Any
    """What kernels read: a `raycast.World`, still without moments."""
    shapes: tuple[Shape, ...]
    """The floor, what stands on it, then the movers."""
    meshes: tuple[wp.Mesh, ...]
    """Of the shapes; kernels know them by number only, so they are kept alive here."""
    parked: tuple[Vehicle, ...]
    """Vehicles within the still world: they keep skylight from the ground."""
    movers: tuple[Vehicle, ...]
    """Body 2 and on."""

    def with_mover(self, vehicle: Vehicle) -> "Stage":
        """The same street with one vehicle more, as the last body."""
        shapes, meshes = (*self.shapes, vehicle.shape), (*self.meshes, _mesh(vehicle.shape))
        world = _world(shapes, meshes)
        world.looks, world.sun, world.seed = self.world.looks, self.world.sun, self.world.seed
        return Stage(world, shapes, meshes, self.parked, (*self.movers, vehicle))

    def at(self, times: ArrayLike, eye: NDArray | None = None) -> Any:
        """The `raycast.World` at the given times [s], its moments, as it matters around an eye [3]."""
        times = np.atleast_1d(np.asarray(times, np.float64))
        still = np.broadcast_to(np.eye(4), (2, len(times), 4, 4))
        vehicles = self.parked + self.movers
        contacts = np.reshape([v.trajectory.at(times[0]) for v in vehicles], (-1, 4, 4))
        halves = np.reshape([v.size for v in vehicles], (-1, 3)) / 2
        is_near = np.linalg.norm(contacts[:, :3, 3] - (0 if eye is None else eye), axis=1) < CONTACT_REACH
        moving = np.reshape([m.trajectory.at(times) for m in self.movers], (-1, len(times), 4, 4))
        world = World()
        for name in ("bodies", "corner_normals", "look_of_face", "looks", "sun", "seed"):
            setattr(world, name, getattr(self.world, name))
        world.poses = transforms(np.concatenate([still, moving]))
        world.contacts = transforms(contacts[is_near])
        world.halves = _vectors(halves[is_near])
        return world


def build_stage(plan: Plan, sun: NDArray, seed: int) -> Stage:
    """Puts a street on the device; ``sun`` [3] points to the sun."""
    cars = [v.shape.moved(v.trajectory.at(0.0)) for v in plan.parked]
    shapes = (plan.floor, Shape.join([plan.still, *cars]), *(m.shape for m in plan.movers))
    meshes = tuple(_mesh(shape) for shape in shapes)
    world = _world(shapes, meshes)
    world.looks, world.sun, world.seed = plan.palette.looks(), wp.vec3(*sun), wp.uint32(seed)
    return Stage(world, shapes, meshes, plan.parked, plan.movers)


def transforms(a_from_b: NDArray) -> wp.array:
    """Rigid transforms [..., 4, 4] as kernels read them."""
    quats = np.roll(quat_from_rotation(a_from_b[..., :3, :3]), -1, -1)
    rows = np.concatenate([a_from_b[..., :3, 3], quats], -1).astype(np.float32)
    return wp.array(rows, dtype=wp.transform, device="cpu")


def _mesh(shape: Shape) -> wp.Mesh:
    indices = wp.array(np.arange(3 * len(shape), dtype=np.int32), dtype=int, device="cpu")
    return wp.Mesh(_vectors(shape.corners), indices, bvh_constructor="sah")


def _world(shapes: tuple[Shape, ...], meshes: tuple[wp.Mesh, ...]) -> Any:
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
