# type: ignore  (Warp compiles this file, and its types are not Python's)
"""Procedural surfaces: colour, mirror and relief at a point, averaged over the footprint of a pixel."""

import warp as wp

from dwgs.street.filtering import bar, bars, dice, fade, ripple2, ripple3
from dwgs.street.material import Look


@wp.struct
class Texel:
    """What light finds at a point."""

    albedo: wp.vec3
    mirror: float
    normal: wp.vec3


@wp.struct
class Patch:
    """The piece of surface that a pixel sees."""

    point: wp.vec3
    normal: wp.vec3
    across: wp.vec3
    """How the point moves per pixel column."""
    down: wp.vec3
    """How the point moves per pixel row."""


@wp.func
def width_along(patch: Patch, axis: wp.vec3) -> float:
    """Width of the footprint along a unit axis [m]."""
    return wp.abs(wp.dot(patch.across, axis)) + wp.abs(wp.dot(patch.down, axis)) + 1.0e-4


@wp.func
def mix(a: wp.vec3, b: wp.vec3, share: float) -> wp.vec3:
    """A linear blend: all a at share 0, all b at 1."""
    return a + (b - a) * share


@wp.func
def asphalt(look: Look, patch: Patch, seed: wp.uint32) -> Texel:
    """Grain, stains, wheel tracks, repairs and cracks."""
    p = patch.point - look.origin
    wx = width_along(patch, wp.vec3(1.0, 0.0, 0.0))
    wy = width_along(patch, wp.vec3(0.0, 1.0, 0.0))
    width = wp.max(wx, wy)
    flat = wp.vec2(p[0], p[1])
    grain = 0.20 * ripple2(seed, flat, width, 0.07) + 0.14 * ripple2(seed + wp.uint32(1), flat, width, 0.23)
    stain = 0.12 * ripple2(seed + wp.uint32(2), flat, width, 1.1)
    stain += 0.12 * ripple2(seed + wp.uint32(3), wp.vec2(p[0] / 5.0, p[1]), width, 2.6)
    tracks = bars(p[1] + 0.85, wp.max(wy, 0.5), 1.7, 0.55, 1.15)  # wheels polish two tracks in each lane
    tone = 1.0 + grain + stain - 0.10 * tracks
    # square repairs, darker and sealed at their rim
    cell_x = wp.floor(p[0] / 9.0)
    cell_y = wp.floor(p[1] / 3.4)
    if dice(seed, cell_x, cell_y) < 0.30:
        x0 = cell_x * 9.0 + 1.0 + 3.0 * dice(seed + wp.uint32(5), cell_x, cell_y)
        y0 = cell_y * 3.4 + 0.3 + 0.9 * dice(seed + wp.uint32(6), cell_x, cell_y)
        length = 1.6 + 3.0 * dice(seed + wp.uint32(7), cell_x, cell_y)
        span = 0.9 + 0.9 * dice(seed + wp.uint32(8), cell_x, cell_y)
        inner = bar(p[0], wx, x0, x0 + length) * bar(p[1], wy, y0, y0 + span)
        outer = bar(p[0], wx, x0 - 0.06, x0 + length + 0.06) * bar(p[1], wy, y0 - 0.06, y0 + span + 0.06)
        tone = tone * (1.0 - 0.18 * inner) - 0.28 * (outer - inner)
    # cracks: where two slow ripples meet
    if width < 0.25:
        ridge = wp.noise(seed + wp.uint32(21), flat * 0.45) + 0.25 * wp.noise(seed + wp.uint32(22), flat * 2.3)
        thin = 0.45 * wp.max(width, 0.02)
        crack = 1.0 - wp.smoothstep(0.3 * thin, 1.6 * thin, wp.abs(ridge))
        tone -= 0.45 * crack * wp.min(0.02 / width, 1.0) * fade(width, 0.25)
    texel = Texel()
    texel.albedo = look.color * wp.max(tone, 0.25)
    texel.normal = patch.normal
    return texel


@wp.func
def slabs(look: Look, patch: Patch, seed: wp.uint32) -> Texel:
    """Paving stones with joints."""
    p = patch.point - look.origin
    wx = width_along(patch, wp.vec3(1.0, 0.0, 0.0))
    wy = width_along(patch, wp.vec3(0.0, 1.0, 0.0))
    width = wp.max(wx, wy)
    flat = wp.vec2(p[0], p[1])
    tone = 1.0 + 0.10 * ripple2(seed + wp.uint32(31), flat, width, 0.11)
    tone += 0.10 * ripple2(seed + wp.uint32(32), flat, width, 1.7)
    tone += 0.22 * (dice(seed, wp.floor(p[0] / 0.9), wp.floor(p[1] / 0.8)) - 0.5) * wp.min(0.3 / width, 1.0)
    joints = 1.0 - bars(p[0], wx, 0.9, 0.02, 0.9) * bars(p[1], wy, 0.8, 0.02, 0.8)
    texel = Texel()
    texel.albedo = mix(look.color * tone, look.accent, 0.7 * joints)
    texel.normal = patch.normal
    return texel


@wp.func
def wall(look: Look, patch: Patch, seed: wp.uint32) -> wp.vec3:
    """Bricks where the pattern is `BRICK` (3), else plaster."""
    p = patch.point
    side = wp.normalize(wp.vec3(patch.normal[1], -patch.normal[0], 1.0e-6))
    u = wp.dot(p - look.origin, side)
    v = p[2]
    wu = width_along(patch, side)
    wv = width_along(patch, wp.vec3(0.0, 0.0, 1.0))
    width = wp.max(wu, wv)
    flat = wp.vec2(u, v)
    tone = 1.0 + 0.08 * ripple2(seed + wp.uint32(41), flat, width, 2.1)
    tone += 0.10 * ripple2(seed + wp.uint32(42), wp.vec2(u, v / 5.0), width, 0.5)  # rain runs down
    tone -= 0.25 * wp.exp(-v / 0.5)  # and splashes up
    if look.pattern == 3:
        row = wp.floor(v / 0.085)
        shift = 0.13 * (row - 2.0 * wp.floor(row / 2.0))
        stones = bars(u + shift, wu, 0.26, 0.014, 0.26) * bars(v, wv, 0.085, 0.014, 0.085)
        stone = dice(seed, wp.floor((u + shift) / 0.26), row) - 0.5
        tone += 0.35 * stone * wp.min(0.05 / width, 1.0)
        return mix(wp.vec3(0.42, 0.39, 0.35), look.color * tone, stones)
    tone += 0.06 * ripple2(seed + wp.uint32(43), flat, width, 0.16)
    return look.color * tone


@wp.func
def facade(look: Look, patch: Patch, seed: wp.uint32) -> Texel:
    """A wall with rows of windows, and doors in the ground floor."""
    texel = Texel()
    texel.normal = patch.normal
    color = wall(look, patch, seed)
    bay = look.windows[0]
    if bay > 0.0:
        storey = look.windows[1]
        ground = look.windows[2]
        side = wp.normalize(wp.vec3(patch.normal[1], -patch.normal[0], 1.0e-6))
        u = wp.dot(patch.point - look.origin, side)
        wu = width_along(patch, side)
        wv = width_along(patch, wp.vec3(0.0, 0.0, 1.0))
        mid = 0.5 * bay
        half = 0.27 * bay
        v = patch.point[2] - ground
        low = 0.85
        high = storey - 0.55
        period = storey
        cell = wp.floor(u / bay)
        row = wp.floor(v / storey)
        lucky = dice(seed + wp.uint32(51), cell, look.origin[0])
        is_door = False
        if v < -0.02:
            v = patch.point[2]
            period = 100.0
            low = 0.75
            high = ground - 0.75
            row = -1.0
            if look.pattern == 7:  # SHOP: glass from wall to wall
                half = 0.5 * bay - 0.18
                low = 0.45
            elif cell - 3.0 * wp.floor(cell / 3.0) == 1.0:
                is_door = True
                low = 0.12
                half = 0.55
        frame = bars(u, wu, bay, mid - half, mid + half) * bars(v, wv, period, low, high)
        pane = bars(u, wu, bay, mid - half + 0.07, mid - 0.03) + bars(u, wu, bay, mid + 0.03, mid + half - 0.07)
        split = low + 0.68 * (high - low)
        pane *= bars(v, wv, period, low + 0.07, split - 0.03) + bars(v, wv, period, split + 0.03, high - 0.07)
        trim = bars(u, wu, bay, mid - half - 0.12, mid + half + 0.12)
        sill = trim * bars(v, wv, period, low - 0.10, low)
        under = trim * bars(v, wv, period, low - 0.24, low - 0.10)
        head = trim * bars(v, wv, period, high, high + 0.16)
        color = mix(color, look.accent, 0.8 * sill + 0.55 * head)
        color = color * (1.0 - 0.35 * under)
        color = mix(color, look.accent, frame)
        room = dice(seed + wp.uint32(52), cell * 3.0 + look.origin[0], row)
        inside = wp.vec3(0.035, 0.045, 0.055) * (0.6 + room)
        if room > 0.72:
            inside = wp.vec3(0.30, 0.27, 0.22) * room  # curtains
        if is_door:
            inside = mix(wp.vec3(0.12, 0.05, 0.03), wp.vec3(0.03, 0.08, 0.10), lucky)
        shade = bars(v, wv, period, high - 0.22, high) * 0.55  # the lintel shades the pane
        color = mix(color, inside * (1.0 - shade), pane)
        texel.mirror = 0.30 * pane
        if is_door:
            texel.mirror = 0.0
        if look.pattern == 7 and row < 0.0:
            sign = bar(v, wv, ground - 0.62, ground - 0.08)
            hue = dice(seed + wp.uint32(53), look.origin[0], look.origin[1])
            board = mix(wp.vec3(0.36, 0.05, 0.04), wp.vec3(0.03, 0.12, 0.22), wp.step(0.35 - hue))
            board = mix(board, wp.vec3(0.05, 0.16, 0.08), wp.step(0.7 - hue))
            color = mix(color, board, sign)
            letters = bars(u, wu, 0.31, 0.06, 0.25) * bar(v, wv, ground - 0.46, ground - 0.24)
            letters *= bars(u, wu, 2.0 * bay, 0.35 * bay, 1.65 * bay)
            color = mix(color, wp.vec3(0.75, 0.72, 0.62), letters * 0.9)
    texel.albedo = color
    return texel


@wp.func
def leaves(look: Look, patch: Patch, seed: wp.uint32) -> Texel:
    """Light and dark leaves in clumps, with relief."""
    p = patch.point
    width = wp.length(patch.across) + wp.length(patch.down)
    clump = ripple3(seed + wp.uint32(61), p, width, 0.6)
    leaf = ripple3(seed + wp.uint32(62), p, width, 0.19)
    texel = Texel()
    share = wp.clamp(0.42 + 0.30 * clump + 0.65 * leaf, 0.0, 1.0)
    texel.albedo = mix(look.color, look.accent, share)
    bump = wp.vec3(
        ripple3(seed + wp.uint32(63), p, width, 0.28),
        ripple3(seed + wp.uint32(64), p, width, 0.28),
        ripple3(seed + wp.uint32(65), p, width, 0.28),
    )
    texel.normal = wp.normalize(patch.normal + 1.0 * bump)
    return texel


@wp.func
def mottled(look: Look, patch: Patch, seed: wp.uint32, period: float, depth: float) -> Texel:
    """One colour, unevenly."""
    width = wp.length(patch.across) + wp.length(patch.down)
    texel = Texel()
    tone = 1.0 + depth * ripple3(seed + wp.uint32(71), patch.point, width, period)
    tone += 0.6 * depth * ripple3(seed + wp.uint32(72), patch.point, width, 7.0 * period)
    texel.albedo = look.color * tone
    texel.normal = patch.normal
    return texel


@wp.func
def texel_at(look: Look, patch: Patch, seed: wp.uint32) -> Texel:
    """The pattern of a look (see `dwgs.street.material`) over a patch."""
    if look.pattern == 1:
        return asphalt(look, patch, seed)
    if look.pattern == 2:
        return slabs(look, patch, seed)
    if look.pattern == 3 or look.pattern == 4 or look.pattern == 7:
        return facade(look, patch, seed)
    if look.pattern == 5:
        return leaves(look, patch, seed)
    if look.pattern == 6:
        return mottled(look, patch, seed, 0.06, 0.35)
    if look.pattern == 8:
        return mottled(look, patch, seed, 0.20, 0.25)
    texel = Texel()
    texel.albedo = look.color
    texel.mirror = look.mirror
    texel.normal = patch.normal
    return texel
