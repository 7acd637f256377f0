# type: ignore  (Warp compiles this file, and its types are not Python's)
"""The sky, the hills under it, and what a shiny surface sees of its surroundings."""

import warp as wp

from dwgs.street.filtering import dice


@wp.func
def clear_sky(direction: wp.vec3, sun: wp.vec3) -> wp.vec3:
    """Linear radiance without clouds: pale at the horizon, deep at the zenith, bright about the sun."""
    height = wp.sqrt(wp.max(direction[2], 0.0))
    horizon = wp.vec3(0.72, 0.80, 0.90)
    zenith = wp.vec3(0.16, 0.33, 0.66)
    glow = wp.pow(wp.max(wp.dot(direction, sun), 0.0), 24.0)
    return horizon + (zenith - horizon) * height + wp.vec3(0.30, 0.24, 0.14) * glow


@wp.func
def cloud_cover(direction: wp.vec3, seed: wp.uint32) -> float:
    """Share of cloud in [0, 1] on a flat layer overhead."""
    flat = wp.vec2(direction[0], direction[1]) / (wp.max(direction[2], 0.0) + 0.18)
    density = wp.float32(0.0)
    weight = wp.float32(0.55)
    scale = wp.float32(1.1)
    for octave in range(4):
        density += weight * wp.noise(seed + wp.uint32(octave), flat * scale)
        weight *= 0.55
        scale *= 2.1
    return wp.smoothstep(-0.02, 0.42, density) * wp.smoothstep(0.0, 0.20, direction[2])


@wp.func
def sky(direction: wp.vec3, sun: wp.vec3, seed: wp.uint32) -> wp.vec3:
    """Linear radiance from infinity: sky, clouds, hills and a far skyline."""
    azimuth = wp.atan2(direction[1], direction[0])
    color = clear_sky(direction, sun)
    cover = cloud_cover(direction, seed)
    color = color + (wp.vec3(0.95, 0.95, 0.96) - color) * (0.85 * cover)
    hill = 0.030 + 0.022 * wp.noise(seed + wp.uint32(11), azimuth * 2.5)
    hill += 0.006 * wp.noise(seed + wp.uint32(12), azimuth * 14.0)
    house = wp.floor(azimuth / 0.017)
    tower = 0.018 + 0.035 * dice(seed, house, 3.0) * dice(seed, house, 4.0)
    if direction[2] < hill:
        color = wp.vec3(0.44, 0.53, 0.62)
    if direction[2] < tower:
        tone = 0.9 + 0.25 * dice(seed, house, 5.0)
        color = wp.vec3(0.46, 0.50, 0.56) * tone
    return color


@wp.func
def surroundings(direction: wp.vec3, sun: wp.vec3) -> wp.vec3:
    """Linear radiance that a mirror in the street sees: road, facades and sky, all out of focus."""
    above = clear_sky(direction, sun) + wp.vec3(0.12, 0.12, 0.12)
    facades = wp.vec3(0.24, 0.22, 0.20)
    road = wp.vec3(0.15, 0.15, 0.15)
    along = wp.abs(direction[0])  # the street is open at its ends
    roofs = 0.42 - 0.34 * along * along
    upper = facades + (above - facades) * wp.smoothstep(roofs - 0.16, roofs + 0.16, direction[2])
    return road + (upper - road) * wp.smoothstep(-0.12, 0.10, direction[2])
