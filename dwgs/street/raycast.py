# type: ignore  (Warp compiles this file, and its types are not Python's)
"""Rays to triangles: what a ray meets, and whether the sun is seen."""

import warp as wp

from dwgs.street.material import Look

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(2000.0)
"""Nothing is further away than this [m]."""


@wp.struct
class Body:
    """A rigid piece of the world: 0 is the floor, 1 all that stands on it, the others move."""

    mesh: wp.uint64
    first_face: int
    radius: float
    """Of the ball about its origin that holds it [m]."""


@wp.struct
class World:
    """Everything a ray can meet, and where it is at some moments."""

    bodies: wp.array(dtype=Body)
    corner_normals: wp.array(dtype=wp.vec3)
    look_of_face: wp.array(dtype=int)
    looks: wp.array(dtype=Look)
    sun: wp.vec3
    seed: wp.uint32
    poses: wp.array2d(dtype=wp.transform)
    """[bodies, moments]."""
    contacts: wp.array(dtype=wp.transform)
    """Poses of vehicles, which keep skylight from the ground at the first moment."""
    halves: wp.array(dtype=wp.vec3)
    """Half sizes of the same [m]."""


@wp.struct
class Hit:
    """Where a ray ends; body -1 is the sky."""

    range: float
    body: int
    face: int
    normal: wp.vec3
    """Smooth."""
    facet: wp.vec3
    """Of the triangle, towards the eye."""


@wp.func
def may_meet(world: World, i: int, moment: int, origin: wp.vec3, direction: wp.vec3) -> bool:
    """Whether it is worth asking the mesh of a body: no rising ray meets the floor."""
    if i == 0:
        return direction[2] < 0.0
    away = wp.transform_get_translation(world.poses[i, moment]) - origin
    along = wp.max(wp.dot(away, direction), 0.0)
    radius = world.bodies[i].radius
    return wp.length_sq(away - direction * along) < radius * radius


@wp.func
def cast(world: World, moment: int, only: int, origin: wp.vec3, direction: wp.vec3) -> Hit:
    """The first thing on a ray; ``only`` names one body, or -1 for all."""
    hit = Hit()
    hit.range = FAR
    hit.body = -1
    for i in range(world.bodies.shape[0]):
        body = world.bodies[i]
        pose = world.poses[i, moment]
        if (only >= 0 and only != i) or not may_meet(world, i, moment, origin, direction):
            continue
        back = wp.transform_inverse(pose)
        o = wp.transform_point(back, origin)
        d = wp.transform_vector(back, direction)
        q = wp.mesh_query_ray(body.mesh, o, d, hit.range)
        if q.result:
            hit.range = q.t
            hit.body = i
            hit.face = body.first_face + q.face
            corner = 3 * hit.face
            normal = (
                world.corner_normals[corner] * q.u
                + world.corner_normals[corner + 1] * q.v
                + world.corner_normals[corner + 2] * (1.0 - q.u - q.v)
            )
            hit.normal = wp.transform_vector(pose, wp.normalize(normal))
            hit.facet = wp.transform_vector(pose, q.normal)
    if wp.dot(hit.facet, direction) > 0.0:
        hit.facet = -hit.facet
    return hit


@wp.func
def is_free(world: World, origin: wp.vec3, direction: wp.vec3) -> bool:
    """Whether a ray leaves the street without meeting anything."""
    for i in range(world.bodies.shape[0]):
        if may_meet(world, i, 0, origin, direction):
            back = wp.transform_inverse(world.poses[i, 0])
            o = wp.transform_point(back, origin)
            d = wp.transform_vector(back, direction)
            if wp.mesh_query_ray_anyhit(world.bodies[i].mesh, o, d, FAR):
                return False
    return True
