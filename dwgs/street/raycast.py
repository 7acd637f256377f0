"""The Warp kernels: rays to triangles, triangles to light, light to pixels and LiDAR returns."""

import warp as wp

from dwgs.street.material import Look
from dwgs.street.sky import sky, surroundings
from dwgs.street.surface import Patch, mix, texel_at

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(2000.0)
CONTRAST = wp.constant(0.045)
"""Neighbouring pixels that differ by more (of 1, square-root encoded) are sampled again, finer."""


@wp.struct
class Body:
    """A rigid piece of the world: body 0 is all that stands still."""

    mesh: wp.uint64
    first_face: int
    low: wp.vec3
    high: wp.vec3


@wp.struct
class World:
    """Everything a ray can meet. Poses are apart: they change from frame to frame."""

    bodies: wp.array(dtype=Body)
    corner_normals: wp.array(dtype=wp.vec3)
    look_of_face: wp.array(dtype=wp.int32)
    looks: wp.array(dtype=Look)
    sun: wp.vec3
    seed: wp.uint32


@wp.struct
class Eye:
    """A pinhole camera, at a window of its image."""

    pose: wp.transform
    fx: float
    fy: float
    cx: float
    cy: float
    column: int
    row: int


@wp.struct
class Hit:
    """Where a ray ends; body -1 is the sky."""

    range: float
    body: int
    face: int
    normal: wp.vec3
    facet: wp.vec3


@wp.struct
class Sample:
    """What a pixel sees through one point of its area."""

    color: wp.vec3
    range: float
    body: int


@wp.func
def meets_box(low: wp.vec3, high: wp.vec3, origin: wp.vec3, direction: wp.vec3) -> bool:
    near = float(0.0)
    far = float(FAR)
    for axis in range(3):
        slope = 1.0 / (direction[axis] + wp.where(wp.abs(direction[axis]) < 1.0e-12, 1.0e-12, 0.0))
        a = (low[axis] - origin[axis]) * slope
        b = (high[axis] - origin[axis]) * slope
        near = wp.max(near, wp.min(a, b))
        far = wp.min(far, wp.max(a, b))
    return near <= far


@wp.func
def cast(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    moment: int,
    only: int,
    origin: wp.vec3,
    direction: wp.vec3,
) -> Hit:
    """The first thing on a ray; ``only`` names one body, or -1 for all."""
    hit = Hit()
    hit.range = FAR
    hit.body = -1
    for i in range(world.bodies.shape[0]):
        if only >= 0 and only != i:
            continue
        body = world.bodies[i]
        pose = poses[i, moment]
        back = wp.transform_inverse(pose)
        o = wp.transform_point(back, origin)
        d = wp.transform_vector(back, direction)
        if i > 0 and not meets_box(body.low, body.high, o, d):
            continue
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
def sees_sun(
    world: World, poses: wp.array2d(dtype=wp.transform), moment: int, origin: wp.vec3, direction: wp.vec3
) -> bool:
    for i in range(world.bodies.shape[0]):
        body = world.bodies[i]
        back = wp.transform_inverse(poses[i, moment])
        o = wp.transform_point(back, origin)
        d = wp.transform_vector(back, direction)
        if i > 0 and not meets_box(body.low, body.high, o, d):
            continue
        if wp.mesh_query_ray_anyhit(body.mesh, o, d, FAR):
            return False
    return True


@wp.func
def openness(
    contacts: wp.array(dtype=wp.transform), halves: wp.array(dtype=wp.vec3), point: wp.vec3
) -> float:
    """Share of skylight that reaches the ground beside and under vehicles: their boxes, softly."""
    share = float(1.0)
    for i in range(contacts.shape[0]):
        pose = contacts[i]
        centre = wp.transform_get_translation(pose)
        if wp.abs(centre[0] - point[0]) < 5.0 and wp.abs(centre[1] - point[1]) < 5.0:
            p = wp.transform_point(wp.transform_inverse(pose), point)
            dx = wp.max(wp.abs(p[0]) - halves[i][0] + 0.25, 0.0)
            dy = wp.max(wp.abs(p[1]) - halves[i][1] + 0.25, 0.0)
            away = wp.sqrt(dx * dx + dy * dy)
            share *= 1.0 - 0.85 * wp.exp(-away * away / 0.22)
    return share


@wp.func
def shade(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    contacts: wp.array(dtype=wp.transform),
    halves: wp.array(dtype=wp.vec3),
    hit: Hit,
    origin: wp.vec3,
    direction: wp.vec3,
    across: wp.vec3,
    down: wp.vec3,
    sun: wp.vec3,
) -> wp.vec3:
    """Linear radiance of a hit: sun with cast shadow, skylight, bounced light, a mirrored surrounding, haze."""
    look = world.looks[world.look_of_face[hit.face]]
    patch = Patch()
    patch.point = origin + direction * hit.range
    patch.normal = hit.normal
    if wp.dot(patch.normal, direction) > 0.0:  # seen past the edge of a coarse round thing
        patch.normal = wp.normalize(patch.normal - direction * (wp.dot(patch.normal, direction) + 0.02))
    slope = wp.min(wp.dot(direction, hit.facet), -0.01)
    patch.across = (across - direction * (wp.dot(across, hit.facet) / slope)) * hit.range
    patch.down = (down - direction * (wp.dot(down, hit.facet) / slope)) * hit.range
    texel = texel_at(look, patch, world.seed)
    normal = texel.normal

    light = wp.vec3(0.0, 0.0, 0.0)
    facing = wp.dot(normal, sun)
    lit = False
    if facing > 0.0 and wp.dot(hit.facet, sun) > -0.2:
        lift = patch.point + hit.facet * (0.003 + 2.0e-4 * hit.range)
        if wp.dot(hit.facet, sun) < 0.02:
            lift = lift + sun * 0.08  # a coarse facet must not shade its own smooth side
        lit = sees_sun(world, poses, 0, lift, sun)
    if lit:
        light = wp.vec3(1.62, 1.46, 1.22) * facing
    up = 0.5 + 0.5 * normal[2]
    canyon = 0.72 + 0.28 * wp.clamp(patch.point[2] / 10.0, 0.0, 1.0)
    open = canyon
    if hit.body == 0 and look.surface == 1:  # SURFACES: ground
        open = canyon * openness(contacts, halves, patch.point)
    skylight = mix(wp.vec3(0.20, 0.18, 0.16), wp.vec3(0.42, 0.50, 0.62), up)
    light = light + skylight * open
    color = wp.cw_mul(texel.albedo, light)

    if texel.mirror > 0.0:
        cosine = wp.max(-wp.dot(direction, normal), 0.0)
        grazing = wp.pow(1.0 - cosine, 5.0)
        share = texel.mirror + (0.85 - texel.mirror) * grazing * wp.min(20.0 * texel.mirror, 1.0)
        mirrored = direction + normal * (2.0 * cosine)
        color = mix(color, surroundings(wp.normalize(mirrored), sun), share)
        if lit:
            halfway = wp.normalize(sun - direction)
            glint = wp.pow(wp.max(wp.dot(normal, halfway), 0.0), 120.0)
            color = color + wp.vec3(5.0, 4.6, 4.0) * (glint * share)
    haze = 1.0 - wp.exp(-hit.range / 900.0)
    return mix(color, wp.vec3(0.66, 0.74, 0.83), haze)


@wp.func
def expose(color: wp.vec3) -> wp.vec3:
    """Linear display light in [0, 1]: straight up to a soft shoulder."""
    out = wp.vec3()
    for i in range(3):
        x = wp.max(color[i], 0.0)
        if x > 0.55:
            x = 0.55 + 0.45 * (1.0 - wp.exp((0.55 - x) / 0.45))
        out[i] = x
    return out


@wp.func
def encode(x: float) -> float:
    """sRGB (IEC 61966-2-1) from linear, both in [0, 1]."""
    if x <= 0.0031308:
        return 12.92 * x
    return 1.055 * wp.pow(x, 1.0 / 2.4) - 0.055


@wp.func
def look_through(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    contacts: wp.array(dtype=wp.transform),
    halves: wp.array(dtype=wp.vec3),
    eye: Eye,
    only: int,
    x: float,
    y: float,
    sun: wp.vec3,
) -> Sample:
    """What the eye sees through pixel position (x, y)."""
    ray = wp.vec3((x - eye.cx) / eye.fx, (y - eye.cy) / eye.fy, 1.0)
    length = wp.length(ray)
    direction = wp.transform_vector(eye.pose, ray / length)
    right = wp.transform_vector(eye.pose, wp.vec3(1.0, 0.0, 0.0)) / (eye.fx * length)
    below = wp.transform_vector(eye.pose, wp.vec3(0.0, 1.0, 0.0)) / (eye.fy * length)
    across = right - direction * wp.dot(right, direction)
    down = below - direction * wp.dot(below, direction)
    origin = wp.transform_get_translation(eye.pose)
    hit = cast(world, poses, 0, only, origin, direction)
    sample = Sample()
    sample.range = hit.range
    sample.body = hit.body
    if hit.body >= 0:
        sample.color = expose(
            shade(world, poses, contacts, halves, hit, origin, direction, across, down, sun)
        )
    elif only >= 0:
        sample.color = wp.vec3(0.2140, 0.2140, 0.2140)  # grey 127
    else:
        sample.color = expose(sky(direction, world.sun, world.seed))
    return sample


@wp.kernel
def draw(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    contacts: wp.array(dtype=wp.transform),
    halves: wp.array(dtype=wp.vec3),
    eye: Eye,
    only: int,
    first: int,
    colors: wp.array2d(dtype=wp.vec3),
    bodies: wp.array2d(dtype=int),
):
    """One sample in the middle of each pixel."""
    row, column = wp.tid()
    row += first
    x = float(eye.column + column) + 0.5
    y = float(eye.row + row) + 0.5
    sample = look_through(world, poses, contacts, halves, eye, only, x, y, world.sun)
    colors[row, column] = sample.color
    bodies[row, column] = sample.body


@wp.func
def differs(a: wp.vec3, b: wp.vec3) -> bool:
    d = float(0.0)
    for i in range(3):
        d = wp.max(d, wp.abs(wp.sqrt(a[i]) - wp.sqrt(b[i])))
    return d > CONTRAST


@wp.kernel
def refine(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    contacts: wp.array(dtype=wp.transform),
    halves: wp.array(dtype=wp.vec3),
    eye: Eye,
    only: int,
    first: int,
    pattern: wp.array(dtype=wp.vec4),
    colors: wp.array2d(dtype=wp.vec3),
    bodies: wp.array2d(dtype=int),
    pixels: wp.array3d(dtype=wp.uint8),
    share: wp.array2d(dtype=wp.uint8),
):
    """Sample again where neighbours differ, and write bytes: sRGB, and the share of the last body."""
    row, column = wp.tid()
    row += first
    height = colors.shape[0]
    width = colors.shape[1]
    color = colors[row, column]
    last = world.bodies.shape[0] - 1
    covered = float(0.0)
    if bodies[row, column] == last:
        covered += 1.0
    edge = False
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            r = wp.clamp(row + dy, 0, height - 1)
            c = wp.clamp(column + dx, 0, width - 1)
            if (dx == 0 or dy == 0) and differs(color, colors[r, c]):
                edge = True
            if (bodies[r, c] == last) != (bodies[row, column] == last):
                edge = True
    if edge:
        total = wp.vec3()
        covered *= 0.0
        for i in range(pattern.shape[0]):
            jitter = pattern[i]
            x = float(eye.column + column) + jitter[0]
            y = float(eye.row + row) + jitter[1]
            sun = wp.normalize(world.sun + wp.vec3(jitter[2], -jitter[2], jitter[3]))
            sample = look_through(world, poses, contacts, halves, eye, only, x, y, sun)
            total += sample.color
            if sample.body == last:
                covered += 1.0
        color = total / float(pattern.shape[0])
        covered = covered / float(pattern.shape[0])
    for i in range(3):
        pixels[row, column, i] = wp.uint8(255.0 * encode(wp.min(color[i], 1.0)) + 0.5)
    share[row, column] = wp.uint8(255.0 * covered + 0.5)


@wp.kernel
def measure_depth(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    eye: Eye,
    only: int,
    first: int,
    depth: wp.array2d(dtype=float),
):
    """z-depth of the middle of each pixel; infinite in the sky."""
    row, column = wp.tid()
    row += first
    x = float(eye.column + column) + 0.5
    y = float(eye.row + row) + 0.5
    ray = wp.vec3((x - eye.cx) / eye.fx, (y - eye.cy) / eye.fy, 1.0)
    length = wp.length(ray)
    direction = wp.transform_vector(eye.pose, ray / length)
    hit = cast(world, poses, 0, only, wp.transform_get_translation(eye.pose), direction)
    if hit.body >= 0:
        depth[row, column] = hit.range / length
    else:
        depth[row, column] = wp.inf


@wp.kernel
def sweep(
    world: World,
    poses: wp.array2d(dtype=wp.transform),
    sensor: wp.array(dtype=wp.transform),
    directions: wp.array2d(dtype=wp.vec3),
    first: int,
    reach: float,
    ranges: wp.array2d(dtype=float),
    surfaces: wp.array2d(dtype=wp.uint8),
):
    """Range of every beam at every azimuth, each azimuth at its own moment; 0 where nothing returns."""
    column, beam = wp.tid()
    column += first
    direction = wp.transform_vector(sensor[column], directions[column, beam])
    hit = cast(world, poses, column, -1, wp.transform_get_translation(sensor[column]), direction)
    if hit.body >= 0 and hit.range < reach:
        ranges[column, beam] = hit.range
        surface = world.looks[world.look_of_face[hit.face]].surface
        surfaces[column, beam] = wp.uint8(surface)
    else:
        ranges[column, beam] = 0.0
        surfaces[column, beam] = wp.uint8(0)
