"""The ground: carriageway with its paint, kerbs, pavements, lamps and signs."""

from itertools import pairwise

import numpy as np
import trimesh

from dwgs.street.material import ASPHALT, GRASS, GROUND, SLABS, Material, Palette
from dwgs.street.shape import Shape, box, ellipsoid, grid_surface, pole

LANE = 3.4
"""Width of a lane [m]: the ego lane is centred on y = 0, then come the left lane and the oncoming one."""
RIGHT_KERB = -1.5 * LANE + 1.2
"""y of the right kerb [m]: half a lane, then a parking bay of 2.2 m."""
LEFT_KERB = 2.5 * LANE + 2.2
"""y of the left kerb [m]."""
KERB_HEIGHT = 0.13
PAVEMENT = 3.4
"""Width of a pavement [m]."""
PAINT_HEIGHT = 0.004
"""Paint lies on the asphalt [m]."""


LONGEST = 12.0
"""Strips are cut into pieces [m]: triangles as long as the street would be in the way of every search."""


def rectangle(x: tuple[float, float], y: tuple[float, float], z: float, material: int) -> Shape:
    """A level rectangle [m], facing up."""
    count = max(1, int(np.ceil((x[1] - x[0]) / LONGEST)))
    edges = np.linspace(*x, count + 1)
    points = np.array([[[a, b, z] for b in y] for a in edges])
    return grid_surface(points, np.full((count, 1), material))


def kerb(x: tuple[float, float], y: tuple[float, float], material: int) -> Shape:
    """A row of kerb stones [m]."""
    edges = np.linspace(*x, int(np.ceil((x[1] - x[0]) / LONGEST)) + 1)
    ring = [(y[0], -0.05), (y[0], KERB_HEIGHT), (y[1], KERB_HEIGHT), (y[1], -0.05)]
    sides = [
        grid_surface(np.array([[[a, *p], [a, *q]] for a in edges]), np.full((len(edges) - 1, 1), material))
        for p, q in pairwise(ring)
    ]
    return Shape.join(sides)


def build_kerbs(palette: Palette, start: float, stop: float) -> Shape:
    """The stones between the carriageway and the pavements."""
    stone = palette.add(Material((178, 176, 170), SLABS, (110, 108, 104), surface=GROUND))
    return Shape.join([
        kerb((start, stop), (RIGHT_KERB - 0.15, RIGHT_KERB), stone),
        kerb((start, stop), (LEFT_KERB, LEFT_KERB + 0.15), stone),
    ])  # fmt: skip


def build_floor(palette: Palette, start: float, stop: float) -> Shape:
    """Carriageway, paint, pavements and fields, from x = start to x = stop [m]: level, facing up."""
    asphalt = palette.add(Material((122, 122, 124), ASPHALT, surface=GROUND, origin=(0.0, -1.5 * LANE, 0.0)))
    slabs = palette.add(Material((168, 163, 155), SLABS, (96, 92, 88), surface=GROUND))
    grass = palette.add(Material((96, 116, 62), GRASS, surface=GROUND))
    paint = palette.add(Material((225, 225, 220), GRASS, surface=GROUND))
    yellow = palette.add(Material((214, 170, 60), GRASS, surface=GROUND))
    right, left = RIGHT_KERB, LEFT_KERB
    pieces = [
        rectangle((start, stop), (right, left), 0.0, asphalt),
        rectangle((start, stop), (right - 20, right - 0.15), KERB_HEIGHT, slabs),
        rectangle((start, stop), (left + 0.15, left + 20), KERB_HEIGHT, slabs),
        rectangle((start - 300, stop + 600), (-600, 600), -0.12, grass),
    ]
    h = PAINT_HEIGHT

    def line(x: tuple[float, float], y: float, width: float, material: int) -> Shape:
        return rectangle(x, (y - width / 2, y + width / 2), h, material)

    pieces += [line((x, x + 3.0), LANE / 2, 0.14, paint) for x in np.arange(start, stop - 3, 9.0)]
    pieces += [line((start, stop), 1.5 * LANE + side, 0.12, yellow) for side in (-0.14, 0.14)]
    pieces += [line((start, stop), y, 0.10, paint) for y in (-LANE / 2 - 0.05, 2.5 * LANE + 0.05)]
    for x in np.arange(start + 1, stop, 6.2):  # parking bays
        pieces.append(rectangle((x, x + 0.10), (right, -LANE / 2 - 0.1), h, paint))
        pieces.append(rectangle((x, x + 0.10), (2.5 * LANE + 0.1, left), h, paint))
    for x in np.arange(52.0, stop - 10, 92.0):  # zebra crossings, over the parking bays too
        pieces += [rectangle((x, x + 3.6), (y, y + 0.5), 2 * h, paint) for y in np.arange(right + 0.3, left - 0.5, 1.0)]
        for y in (0.0, LANE):
            pieces.append(rectangle((x - 2.2, x - 1.8), (y - LANE / 2 + 0.2, y + LANE / 2 - 0.2), h, paint))
            pieces.append(_arrow(x - 14, y, h, paint))
    return Shape.join(pieces)


def _arrow(x: float, y: float, z: float, material: int) -> Shape:
    """A painted arrow that points along the road."""
    corners = np.array([[2.2, 0.45, 0], [2.2, -0.45, 0], [3.6, 0.0, 0]]) + np.array([x, y, z])
    head = Shape.of(trimesh.Trimesh(corners, [[0, 1, 2]], process=False), material)
    return Shape.join([rectangle((x, x + 2.2), (y - 0.09, y + 0.09), z, material), head])


def build_lamp(palette: Palette, side: float) -> Shape:
    """A street lamp at the origin whose arm reaches over the road: to +y for side 1, to -y for side -1."""
    steel = palette.add(Material((92, 98, 100), mirror=0.05))
    glass = palette.add(Material((235, 232, 220)))
    arm = trimesh.creation.cylinder(radius=0.05, segment=[[0, 0, 7.2], [0, side * 1.9, 7.6]], sections=8)
    return Shape.join([
        pole(0.14, 0.9, steel, sections=10),
        pole(0.08, 7.3, steel),
        Shape.of(arm, steel, smooth=True),
        ellipsoid((0.16, 0.42, 0.09), steel).at(0, side * 2.1, 7.64),
        ellipsoid((0.12, 0.34, 0.07), glass).at(0, side * 2.1, 7.59),
    ])  # fmt: skip


def build_sign(palette: Palette, color: tuple[int, int, int]) -> Shape:
    """A round traffic sign at the origin, seen from -x."""
    steel = palette.add(Material((150, 152, 154), mirror=0.05))
    face, white = palette.add(Material(color)), palette.add(Material((238, 238, 236)))
    facing = trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0))
    disc = trimesh.creation.cylinder(radius=0.34, height=0.03, sections=28, transform=facing)
    bar = box((-0.045, -0.22, -0.06), (0.0, 0.22, 0.06), white)
    return Shape.join([
        pole(0.035, 2.7, steel),
        Shape.of(disc, face).at(-0.05, 0, 2.4),
        bar.at(-0.05, 0, 2.4),
    ])  # fmt: skip


def build_bollard(palette: Palette) -> Shape:
    """A short iron post at the origin."""
    iron = palette.add(Material((44, 46, 50), mirror=0.04))
    return Shape.join([pole(0.07, 0.85, iron), ellipsoid((0.085, 0.085, 0.085), iron).at(0, 0, 0.88)])
