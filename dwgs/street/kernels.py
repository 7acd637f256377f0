# type: ignore  (Warp compiles this file, and its types are not Python's)
"""The Warp kernels: pixels, depth and LiDAR returns."""

import warp as wp

from dwgs.street.light import Ray, encode, expose, shade
from dwgs.street.raycast import World, cast
from dwgs.street.sky import sky
from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})

FAINT = wp.constant(0.08)
"""Neighbours on different things whose colours (square-root encoded) differ by more are sampled again ..."""
STRONG = wp.constant(0.3)
"""... with the first half of the pattern, and with all of it if they differ by more than this."""
GREY = wp.constant(wp.vec3(0.2122, 0.2122, 0.2122))
"""Linear light of sRGB 127, behind a body drawn alone."""


@wp.struct
class Eye:
    """A pinhole camera."""

    pose: wp.transform
    fx: float
    fy: float
    cx: float
    cy: float
    only: int
    """The one body it sees, or -1 for all."""


@wp.struct
class Sample:
    """What is seen through one point of a pixel."""

    color: wp.vec3
    range: float
    body: int
    kind: int
    """Equal where neighbours lie on like surfaces in like light: there the pattern is averaged already."""


@wp.func
def ray_through(eye: Eye, x: float, y: float) -> Ray:
    """The ray through pixel position (x, y)."""
    local = wp.vec3((x - eye.cx) / eye.fx, (y - eye.cy) / eye.fy, 1.0)
    length = wp.length(local)
    ray = Ray()
    ray.origin = wp.transform_get_translation(eye.pose)
    ray.direction = wp.transform_vector(eye.pose, local / length)
    right = wp.transform_vector(eye.pose, wp.vec3(1.0, 0.0, 0.0)) / (eye.fx * length)
    below = wp.transform_vector(eye.pose, wp.vec3(0.0, 1.0, 0.0)) / (eye.fy * length)
    ray.across = right - ray.direction * wp.dot(right, ray.direction)
    ray.down = below - ray.direction * wp.dot(below, ray.direction)
    return ray


@wp.func
def look_through(world: World, eye: Eye, x: float, y: float, sun: wp.vec3) -> Sample:
    """What the eye sees through pixel position (x, y)."""
    ray = ray_through(eye, x, y)
    hit = cast(world, 0, eye.only, ray.origin, ray.direction)
    sample = Sample()
    sample.range = hit.range
    sample.body = hit.body
    if hit.body >= 0:
        shaded = shade(world, hit, ray, sun)
        sample.color = expose(shaded.color)
        sample.kind = 1 + 2 * world.look_of_face[hit.face]
        if shaded.is_lit:
            sample.kind += 1
        for axis in range(3):
            sample.kind = 3 * sample.kind + int(wp.round(hit.facet[axis])) + 1
    elif eye.only >= 0:
        sample.color = GREY
    else:
        sample.color = expose(sky(ray.direction, world.sun, world.seed))
    return sample


@wp.kernel
def draw(
    world: World,
    eye: Eye,
    first: int,
    colors: wp.array2d(dtype=wp.vec3),
    ranges: wp.array2d(dtype=float),
    bodies: wp.array2d(dtype=int),
    kinds: wp.array2d(dtype=int),
):
    """One sample in the middle of each pixel of the rows from ``first`` on."""
    row, column = wp.tid()
    row += first
    sample = look_through(world, eye, float(column) + 0.5, float(row) + 0.5, world.sun)
    colors[row, column] = sample.color
    ranges[row, column] = sample.range
    bodies[row, column] = sample.body
    kinds[row, column] = sample.kind


@wp.func
def contrast_of_edge(
    row: int,
    column: int,
    colors: wp.array2d(dtype=wp.vec3),
    ranges: wp.array2d(dtype=float),
    kinds: wp.array2d(dtype=int),
) -> float:
    """The largest difference to those of the four neighbours that show another thing."""
    contrast = wp.float32(0.0)
    for i in range(4):
        step = 2 * (i % 2) - 1
        r = wp.clamp(row + wp.where(i < 2, step, 0), 0, colors.shape[0] - 1)
        c = wp.clamp(column + wp.where(i < 2, 0, step), 0, colors.shape[1] - 1)
        a = ranges[row, column]
        b = ranges[r, c]
        if kinds[row, column] != kinds[r, c] or wp.abs(a - b) > 0.08 * wp.min(a, b) or kinds[r, c] == 0:
            for k in range(3):
                difference = wp.abs(wp.sqrt(colors[row, column][k]) - wp.sqrt(colors[r, c][k]))
                contrast = wp.max(contrast, difference)
    return contrast


@wp.kernel
def refine(
    world: World,
    eye: Eye,
    first: int,
    pattern: wp.array(dtype=wp.vec4),
    colors: wp.array2d(dtype=wp.vec3),
    ranges: wp.array2d(dtype=float),
    bodies: wp.array2d(dtype=int),
    kinds: wp.array2d(dtype=int),
    pixels: wp.array3d(dtype=wp.uint8),
    share: wp.array2d(dtype=wp.uint8),
):
    """Sample edges again, finely, and write bytes: sRGB, and how much of the pixel the last body covers."""
    row, column = wp.tid()
    row += first
    last = world.bodies.shape[0] - 1
    color = colors[row, column]
    covered = wp.where(bodies[row, column] == last, 1.0, 0.0)
    contrast = contrast_of_edge(row, column, colors, ranges, kinds)
    if contrast > FAINT:
        total = wp.vec3()
        count = wp.int32(0)
        samples = wp.where(contrast > STRONG, pattern.shape[0], pattern.shape[0] / 2)
        for i in range(samples):
            jitter = pattern[i]
            sun = wp.normalize(world.sun + wp.vec3(jitter[2], -jitter[2], jitter[3]))
            sample = look_through(world, eye, float(column) + jitter[0], float(row) + jitter[1], sun)
            total += sample.color
            if sample.body == last:
                count += 1
        color = total / float(samples)
        covered = float(count) / float(samples)
    for i in range(3):
        pixels[row, column, i] = wp.uint8(255.0 * encode(color[i]) + 0.5)
    share[row, column] = wp.uint8(255.0 * covered + 0.5)


@wp.kernel
def measure_depth(world: World, eye: Eye, first: int, depth: wp.array2d(dtype=float)):
    """z-depth of the middle of each pixel; infinite in the sky."""
    row, column = wp.tid()
    row += first
    ray = ray_through(eye, float(column) + 0.5, float(row) + 0.5)
    hit = cast(world, 0, eye.only, ray.origin, ray.direction)
    depth[row, column] = wp.inf
    if hit.body >= 0:
        ahead = wp.transform_vector(eye.pose, wp.vec3(0.0, 0.0, 1.0))
        depth[row, column] = hit.range * wp.dot(ray.direction, ahead)


@wp.kernel
def sweep(
    world: World,
    sensor: wp.array(dtype=wp.transform),
    directions: wp.array2d(dtype=wp.vec3),
    reach: float,
    ranges: wp.array2d(dtype=float),
    surfaces: wp.array2d(dtype=wp.uint8),
):
    """Range of every beam of every column, each column at its own moment; 0 where nothing returns."""
    column, beam = wp.tid()
    direction = wp.transform_vector(sensor[column], directions[column, beam])
    hit = cast(world, column, -1, wp.transform_get_translation(sensor[column]), direction)
    ranges[column, beam] = 0.0
    surfaces[column, beam] = wp.uint8(0)
    if hit.body >= 0 and hit.range < reach:
        ranges[column, beam] = hit.range
        surfaces[column, beam] = wp.uint8(world.looks[world.look_of_face[hit.face]].surface)
