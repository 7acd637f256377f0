# type: ignore  (Warp compiles this file, and its types are not Python's)
"""From a hit to its colour: sun with cast shadow, skylight, bounced light, mirrored surroundings, haze."""

import warp as wp

from dwgs.scene.lidar import SURFACES
from dwgs.street.raycast import Hit, World, is_free
from dwgs.street.sky import surroundings
from dwgs.street.surface import Patch, mix, texel_at

wp.set_module_options({"enable_backward": False})

GROUND = wp.constant(SURFACES.index("ground"))
SUNLIGHT = wp.constant(wp.vec3(1.86, 1.66, 1.36))
SKYLIGHT = wp.constant(wp.vec3(0.34, 0.42, 0.55))
BOUNCED = wp.constant(wp.vec3(0.18, 0.16, 0.14))
"""Light from below: what road and walls give back."""
HAZE = wp.constant(wp.vec3(0.66, 0.74, 0.83))
CLEAR = wp.constant(900.0)
"""Way [m] on which haze takes all but 1/e of a colour."""


@wp.struct
class Ray:
    """A ray through a pixel, with the pixel's footprint."""

    origin: wp.vec3
    direction: wp.vec3
    across: wp.vec3
    """Change of direction per pixel column."""
    down: wp.vec3
    """Change of direction per pixel row."""


@wp.struct
class Shaded:
    """A colour and whether the sun made it."""

    color: wp.vec3
    is_lit: bool


@wp.func
def openness(world: World, point: wp.vec3) -> float:
    """Share of skylight that reaches the ground beside and under vehicles: their boxes, softly."""
    share = wp.float32(1.0)
    for i in range(world.contacts.shape[0]):
        pose = world.contacts[i]
        centre = wp.transform_get_translation(pose)
        if wp.abs(centre[0] - point[0]) < 4.0 and wp.abs(centre[1] - point[1]) < 4.0:
            p = wp.transform_point(wp.transform_inverse(pose), point)
            dx = wp.max(wp.abs(p[0]) - world.halves[i][0] + 0.25, 0.0)
            dy = wp.max(wp.abs(p[1]) - world.halves[i][1] + 0.25, 0.0)
            share *= 1.0 - 0.85 * wp.exp(-(dx * dx + dy * dy) / 0.22)
    return share


@wp.func
def shade(world: World, hit: Hit, ray: Ray, sun: wp.vec3) -> Shaded:
    """Linear radiance of a hit under a sun in this direction."""
    look = world.looks[world.look_of_face[hit.face]]
    patch = Patch()
    patch.point = ray.origin + ray.direction * hit.range
    patch.normal = hit.normal
    turned = wp.dot(patch.normal, ray.direction)
    if turned > 0.0:  # seen past the edge of a coarse round thing
        patch.normal = wp.normalize(patch.normal - ray.direction * (turned + 0.02))
    slope = wp.min(wp.dot(ray.direction, hit.facet), -0.01)
    patch.across = (ray.across - ray.direction * (wp.dot(ray.across, hit.facet) / slope)) * hit.range
    patch.down = (ray.down - ray.direction * (wp.dot(ray.down, hit.facet) / slope)) * hit.range
    texel = texel_at(look, patch, world.seed)
    normal = texel.normal

    shaded = Shaded()
    light = wp.vec3(0.0, 0.0, 0.0)
    facing = wp.dot(normal, sun)
    steep = wp.dot(hit.facet, sun)
    if facing > 0.0 and steep > -0.2:
        lift = patch.point + hit.facet * (0.003 + 2.0e-4 * hit.range)
        if steep < 0.02:
            lift = lift + sun * 0.08  # a coarse facet must not shade its own smooth side
        if is_free(world, lift, sun):
            shaded.is_lit = True
            light = SUNLIGHT * facing
    open = 0.72 + 0.28 * wp.clamp(patch.point[2] / 10.0, 0.0, 1.0)  # the street is a canyon
    if look.surface == GROUND:
        open *= openness(world, patch.point)
    light = light + mix(BOUNCED, SKYLIGHT, 0.5 + 0.5 * normal[2]) * open
    color = wp.cw_mul(texel.albedo, light)

    if texel.mirror > 0.0:
        cosine = wp.max(-wp.dot(ray.direction, normal), 0.0)
        grazing = wp.pow(1.0 - cosine, 5.0)
        share = texel.mirror + (0.85 - texel.mirror) * grazing * wp.min(20.0 * texel.mirror, 1.0)
        mirrored = wp.normalize(ray.direction + normal * (2.0 * cosine))
        color = mix(color, surroundings(mirrored, sun), share)
        if shaded.is_lit:
            halfway = wp.normalize(sun - ray.direction)
            color += wp.vec3(5.0, 4.6, 4.0) * (share * wp.pow(wp.max(wp.dot(normal, halfway), 0.0), 120.0))
    shaded.color = mix(color, HAZE, 1.0 - wp.exp(-hit.range / CLEAR))
    return shaded


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
    return 1.055 * wp.pow(wp.min(x, 1.0), 1.0 / 2.4) - 0.055
