"""The loops over points: project them, find the nearest, blend their discs, look at them from outside."""

# An annotation of a Warp kernel is a value, not a type.
# pyright: reportInvalidTypeForm=false, reportCallIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import warp as wp

from dwgs.warp_start import start_warp

start_warp()
wp.set_module_options({"enable_backward": False})

NEAR = wp.constant(0.1)
"""Points nearer to the camera than this depth [m] are not drawn."""

MOST_HITS = wp.constant(10)
"""Discs that blend in one pixel."""

LEAST_ALPHA = wp.constant(1 / 255)
"""A fainter part of a disc is not drawn."""

OPAQUE = wp.constant(1e-4)
"""A pixel that lets less than this share through is finished."""

LARGEST_STAMP = wp.constant(12.0)
"""A point hides at most so far around it [px]."""

ENOUGH_VOTES = wp.constant(3)
"""Directions that agree on a side before the others are spared."""

OFF_SURFACE = wp.constant(1e-3)
"""A ray starts so far [m] from the face it leaves."""

FAR = wp.constant(100.0)
"""A ray that meets nothing for so long [m] has left the vehicle."""


@wp.kernel
def project(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    closed: bool,
    camera_from_vehicle: wp.mat44,
    K: wp.vec4,
    size: wp.vec2,
    pixels: wp.array(dtype=wp.vec3),
):
    """(u, v, depth) of each point; depth 0 outside the image and, if ``closed``, on a side turned away."""
    i = wp.tid()
    p = wp.transform_point(camera_from_vehicle, points[i])
    seen = p[2] >= NEAR
    if closed:
        seen = seen and wp.dot(wp.transform_vector(camera_from_vehicle, normals[i]), p) < 0.0
    if seen:
        u = K[0] * p[0] / p[2] + K[2]
        v = K[1] * p[1] / p[2] + K[3]
        if u >= 0.0 and v >= 0.0 and u < size[0] and v < size[1]:
            pixels[i] = wp.vec3(u, v, p[2])


@wp.kernel
def find_nearest(pixels: wp.array(dtype=wp.vec3), radius: float, reach: float, nearest: wp.array2d(dtype=float)):
    """Depth of the nearest surface; a point is stamped so wide that it meets its neighbours. One thread.

    Args:
        pixels: (u, v, depth) of each point; depth 0 is skipped.
        radius: Of a disc [px].
        reach: Of a point's stamp [m] times the focal length [px].
        nearest: [H, W] depth, infinite at first.
    """
    for i in range(pixels.shape[0]):
        p = pixels[i]
        if p[2] > 0.0:
            wide = wp.min(wp.max(radius, reach / p[2]), LARGEST_STAMP)
            for y in range(wp.max(int(p[1] - wide), 0), wp.min(int(p[1] + wide) + 1, nearest.shape[0])):
                for x in range(wp.max(int(p[0] - wide), 0), wp.min(int(p[0] + wide) + 1, nearest.shape[1])):
                    nearest[y, x] = wp.min(nearest[y, x], p[2])


@wp.kernel
def blend(
    pixels: wp.array(dtype=wp.vec3),
    colors: wp.array(dtype=wp.vec3),
    radius: float,
    rgb: wp.array2d(dtype=wp.vec3),
    transmittance: wp.array2d(dtype=float),
    hits: wp.array2d(dtype=int),
):
    """Discs over each other in the given order, nearest first: launch one thread.

    Args:
        pixels: (u, v, depth) of each point.
        colors: Of each point.
        radius: Of a disc [px], whose alpha is 1 - d^2 / radius^2.
        rgb: [H, W] premultiplied colour so far.
        transmittance: [H, W] what is left of the canvas.
        hits: [H, W] discs drawn.
    """
    for i in range(pixels.shape[0]):
        p = pixels[i]
        for y in range(wp.max(int(p[1] - radius), 0), wp.min(int(p[1] + radius) + 1, rgb.shape[0])):
            for x in range(wp.max(int(p[0] - radius), 0), wp.min(int(p[0] + radius) + 1, rgb.shape[1])):
                dx = float(x) + 0.5 - p[0]
                dy = float(y) + 0.5 - p[1]
                alpha = 1.0 - (dx * dx + dy * dy) / (radius * radius)
                left = transmittance[y, x]
                if alpha >= LEAST_ALPHA and left >= OPAQUE and hits[y, x] < MOST_HITS:
                    rgb[y, x] = rgb[y, x] + alpha * left * colors[i]
                    transmittance[y, x] = left * (1.0 - alpha)
                    hits[y, x] = hits[y, x] + 1


@wp.kernel
def look_from_outside(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    side: wp.array(dtype=wp.int8),
):
    """The side of each point that rays from afar reach more often: +1 its normal's, -1 the other, 0 none."""
    i = wp.tid()
    votes = int(0)  # noqa: RUF046, UP018 (Warp: a variable, not a constant)
    for k in range(directions.shape[0]):
        facing = wp.dot(normals[i], directions[k])
        # rays along the surface slip between neighbouring faces; one glimpse through a gap decides nothing
        if wp.abs(facing) > 0.1 and wp.abs(votes) < ENOUGH_VOTES:
            outward = wp.sign(facing)
            start = points[i] + OFF_SURFACE * outward * normals[i]
            if not wp.mesh_query_ray_anyhit(mesh, start, directions[k], FAR):
                votes += int(outward)
    side[i] = wp.int8(wp.sign(float(votes)) * wp.min(float(wp.abs(votes)), 1.0))
