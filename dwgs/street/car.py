"""A car out of cross-sections, and the parts that make it one: glass, wheels, lamps, bumpers, mirrors."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from dwgs.scene.insertion import VehiclePoints
from dwgs.scene.pose import pose
from dwgs.street.material import VEHICLE, Material, Palette
from dwgs.street.shape import Shape, box, ellipsoid, grid_surface

PAINT, GLASS, TRIM, TYRE, RIM, LAMP, TAIL, PLATE = range(8)
"""Parts; `Shape.painted` turns them into rows of a palette."""

PARTS = (
    Material((150, 150, 150), mirror=0.05, surface=VEHICLE),
    Material((22, 26, 30), mirror=0.10, surface=VEHICLE),
    Material((30, 31, 33), mirror=0.02, surface=VEHICLE),
    Material((26, 26, 27), surface=VEHICLE),
    Material((168, 170, 174), mirror=0.12, surface=VEHICLE),
    Material((226, 230, 234), mirror=0.10, surface=VEHICLE),
    Material((150, 18, 20), mirror=0.06, surface=VEHICLE),
    Material((226, 226, 220), surface=VEHICLE),
)
"""What the parts are made of; paint varies."""


@dataclass(frozen=True)
class CarDesign:
    """The side view of a car [m]: x from the middle of its length, forward; z from the ground."""

    size: tuple[float, float, float]
    """(length, width, height)."""
    axles: tuple[float, float]
    """x of the rear and the front axle."""
    roof: tuple[tuple[float, float], ...]
    """(x, z) along the top from tail to nose."""
    glass: tuple[float, float, float, float]
    """x where the rear window begins and ends, and where the windscreen begins (at the roof) and ends."""
    belt: float
    """z of the shoulder, where paint ends and side windows begin."""
    wheel: float = 0.325
    """Radius of a wheel."""

    @property
    def half(self) -> float:
        """Half the length [m]."""
        return self.size[0] / 2


SEDAN = CarDesign(
    (4.62, 1.82, 1.45), (-1.36, 1.36),
    ((-2.31, 0.80), (-2.24, 1.02), (-1.72, 1.07), (-0.86, 1.40),
     (-0.30, 1.45), (0.22, 1.41), (1.12, 0.99), (1.75, 0.90), (2.20, 0.74), (2.31, 0.55)),
    (-1.66, -0.90, 0.26, 1.06), 0.93,
)  # fmt: skip
HATCH = CarDesign(
    (4.12, 1.78, 1.50), (-1.26, 1.27),
    ((-2.06, 0.80), (-2.02, 1.02), (-1.80, 1.22), (-1.42, 1.44),
     (-0.40, 1.50), (0.20, 1.45), (1.08, 1.01), (1.60, 0.92), (1.98, 0.76), (2.06, 0.55)),
    (-1.93, -1.48, 0.24, 1.02), 0.95,
)  # fmt: skip
SUV = CarDesign(
    (4.60, 1.90, 1.70), (-1.36, 1.38),
    ((-2.30, 0.90), (-2.26, 1.16), (-2.08, 1.36), (-1.74, 1.64),
     (-0.50, 1.70), (0.20, 1.65), (1.02, 1.18), (1.70, 1.08), (2.20, 0.90), (2.30, 0.62)),
    (-2.18, -1.80, 0.24, 0.96), 1.08, 0.36,
)  # fmt: skip
VAN = CarDesign(
    (4.95, 1.96, 1.98), (-1.50, 1.52),
    ((-2.475, 0.95), (-2.45, 1.40), (-2.40, 1.80), (-2.25, 1.96),
     (-0.50, 1.98), (0.75, 1.92), (1.55, 1.22), (2.05, 1.06), (2.40, 0.86), (2.475, 0.60)),
    (-2.42, -2.33, 0.82, 1.50), 1.12, 0.34,
)  # fmt: skip
DESIGNS = (SEDAN, HATCH, SUV, VAN)


def build_car(design: CarDesign) -> Shape:
    """A car in its own frame (box centre, x forward, y left, z up), its materials the part numbers."""
    _, width, height = design.size
    pieces = [_shell(design), _underbody(design), *_fittings(design)]
    for x in design.axles:
        for side in (-1, 1):
            pieces.append(_wheel(design.wheel, side).at(x, side * (width / 2 - 0.13), design.wheel))
    return Shape.join(pieces).at(0, 0, -height / 2)


def paint_car(car: Shape, palette: Palette, color: tuple[int, int, int]) -> Shape:
    """The car in a colour, with materials of the palette."""
    paint = Material(color, mirror=0.05, surface=VEHICLE)
    return car.painted([palette.add(paint), *(palette.add(m) for m in PARTS[1:])])


def _stations(design: CarDesign) -> NDArray[np.float64]:
    """x of the cross-sections: dense at the ends and about the wheels, exact where glass begins and ends."""
    half = design.half
    ends = half - 0.34 * (1 - np.cos(np.linspace(0, np.pi / 2, 7)))
    arches = [x + (design.wheel + 0.07) * np.cos(np.linspace(0, np.pi, 11)) for x in design.axles]
    rest = np.linspace(-half + 0.4, half - 0.4, 20)
    pillars = np.array([*design.glass, *_pillars(design), *_seams(design).ravel()])
    x = np.unique(np.round(np.concatenate([ends, -ends, *arches, rest, pillars]), 4))
    exact = np.isin(x, np.round(pillars, 4))
    near_exact = np.abs(x[:, None] - pillars).min(1) < 0.02
    return x[exact | ~near_exact]


def _pillars(design: CarDesign) -> tuple[float, ...]:
    """x of the edges of the post between the side windows, and of the foremost and rearmost window corner."""
    rear, _, front, _ = design.glass
    back = max(rear, -design.half + 0.35)
    return (-0.10, -0.02, back + 0.30, min(front + 0.62, design.glass[3] - 0.12))


def _seams(design: CarDesign) -> NDArray[np.float64]:
    """[3, 2] from where to where (x) the gaps before, between and behind the doors go."""
    rear, front = design.axles
    middle = np.array([front - design.wheel - 0.14, -0.06, rear + design.wheel + 0.06])
    return middle[:, None] + [-0.007, 0.007]


def _shell(design: CarDesign) -> Shape:
    """The painted skin with its windows: one smooth surface through cross-sections."""
    half, w = design.half, design.size[1] / 2
    x = _stations(design)
    top_x, top_z = np.array(design.roof).T
    top = PchipInterpolator(top_x, top_z)(x)
    end = np.clip((half - np.abs(x)) / 0.75, 0, 1)
    plan = w * (1 - 0.20 * (1 - end) ** 2.6)  # the corners are rounded in plan
    nose = np.clip((half - np.abs(x)) / 0.16, 0, 1)
    sill = 0.20 + 0.14 * (1 - np.sqrt(1 - (1 - nose) ** 2))
    arch = design.wheel + 0.065
    for axle in design.axles:
        reach = np.clip(arch**2 - (x - axle) ** 2, 0, None)
        sill = np.maximum(sill, np.where(reach > 0, design.wheel + np.sqrt(reach), 0))
    belt = np.minimum(design.belt - 0.05 * np.clip(x / half, 0, 1), top - 0.02)
    house = np.clip(top - belt, 0.02, None)  # how far the cabin rises over the shoulder
    lean = 0.30 * np.clip(house - 0.1, 0, None)

    def at(y: NDArray, z: NDArray) -> NDArray:
        return np.stack([x, y, z], -1)

    low = np.minimum(sill, belt - 0.06)
    body = belt - low
    rows = [
        at(plan - 0.10, low),
        at(plan - 0.045, low + 0.015),
        at(plan - 0.012, low + 0.22 * body),
        at(plan, low + 0.45 * body),
        at(plan - 0.004, low + 0.72 * body),
        at(plan - 0.022, low + 0.90 * body),
        at(plan - 0.055, belt),
        at(plan - 0.080, belt + 0.05 * house),
        at(plan - 0.085 - 0.5 * lean, belt + 0.48 * house),
        at(plan - 0.105 - lean, belt + 0.84 * house),
        at(plan - 0.155 - lean, belt + 0.945 * house),
        at((plan - 0.24 - lean), belt + 0.978 * house),
        at(0.45 * (plan - lean), belt + 0.995 * house),
        at(0.0 * plan, top),
    ]
    side = np.stack(rows, 1)
    mirror = side[:, -2::-1] * [1, -1, 1]
    grid = np.concatenate([side, mirror], 1)[:, ::-1]

    count = len(rows)
    column = np.minimum(np.arange(2 * count - 2), 2 * count - 3 - np.arange(2 * count - 2))
    mid = (x[1:] + x[:-1]) / 2
    parts = np.full((len(x) - 1, 2 * count - 2), PAINT)
    post, post_end, rearmost, foremost = _pillars(design)
    rear0, rear1, front0, front1 = design.glass
    beside = (mid > rearmost) & (mid < foremost) & ~((mid > post) & (mid < post_end))
    across = ((mid > rear0) & (mid < rear1)) | ((mid > front0) & (mid < front1))
    parts[np.ix_(beside, (column == 7) | (column == 8))] = GLASS
    parts[np.ix_(across, column >= 10)] = GLASS
    for low_x, high_x in _seams(design):
        parts[np.ix_((mid > low_x) & (mid < high_x), (column >= 2) & (column < 6))] = TRIM
    parts[:, column <= 1] = TRIM
    parts[np.ix_(mid > half - 0.40, (column == 4) | (column == 5))] = LAMP
    parts[np.ix_(mid < -half + 0.26, (column == 4) | (column == 5))] = TAIL
    return Shape.join([grid_surface(grid, parts), _cap(grid[-1], 1), _cap(grid[0], -1)])


def _cap(section: NDArray, facing: int) -> Shape:
    """Closes an end of the shell, from its left to its right half: lamps, a grille or a bumper."""
    half = (len(section) + 1) // 2
    left, right = section[:half], section[::-1][:half]
    s = np.array([0, 0.1, 0.2, 0.32, 0.5, 0.68, 0.8, 0.9, 1])[None, :, None]
    grid = left[:, None] * (1 - s) + right[:, None] * s
    parts = np.full((half - 1, 8), PAINT)
    parts[:2] = TRIM
    parts[4:6, [0, 1, 6, 7]] = LAMP if facing > 0 else TAIL
    if facing > 0:
        parts[2:4, 2:6] = TRIM
    else:
        parts[2, :] = TRIM
    return grid_surface(grid[:, ::-1] if facing > 0 else grid, parts)


def _underbody(design: CarDesign) -> Shape:
    """What fills the car between its wheels: dark, and seen through the arches."""
    half, w = design.half, design.size[1] / 2
    tub = box((-half + 0.25, -w + 0.30, 0.24), (half - 0.25, w - 0.30, design.belt - 0.15), TRIM)
    floor = box((-half + 0.2, -w + 0.12, 0.21), (half - 0.2, w - 0.12, 0.30), TRIM)
    gaps = [x + sign * (design.wheel + 0.05) for x in design.axles for sign in (-1, 1)]
    return Shape.join([tub, _between(floor, (gaps[1], gaps[2]))])


def _between(shape: Shape, x: tuple[float, float]) -> Shape:
    """A box cut to a range of x."""
    low, high = shape.bounds
    return box((x[0], low[1], low[2]), (x[1], high[1], high[2]), int(shape.materials[0]))


def _wheel(radius: float, side: int) -> Shape:
    """A tyre and a rim of ten spokes about the origin; its face looks to +y for side 1."""
    profile = np.array([
        [0.0, -0.10], [radius - 0.06, -0.10], [radius - 0.015, -0.085], [radius, -0.05], [radius, 0.05],
        [radius - 0.015, 0.085], [radius - 0.06, 0.10],
        [radius - 0.105, 0.095], [radius - 0.11, 0.06], [0.0, 0.06],
    ])  # fmt: skip
    tyre = Shape.of(trimesh.creation.revolve(profile, sections=20), TYRE, smooth=True)
    pieces = [tyre]
    for k in range(5):
        spoke = box((0.03, -0.032, 0.055), (radius - 0.105, 0.032, 0.085), RIM)
        turn = trimesh.transformations.rotation_matrix(2 * np.pi * k / 5 + 0.3, (0, 0, 1))
        pieces.append(spoke.moved(turn))
    ring = trimesh.creation.annulus(radius - 0.135, radius - 0.10, 0.04, sections=20)
    pieces.append(Shape.of(ring, RIM).at(0, 0, 0.075))
    hub = trimesh.creation.cylinder(radius=0.065, height=0.05, sections=14)
    pieces.append(Shape.of(hub, RIM).at(0, 0, 0.07))
    upright = trimesh.transformations.rotation_matrix(-side * np.pi / 2, (1, 0, 0))
    return Shape.join(pieces).moved(upright)


def _fittings(design: CarDesign) -> list[Shape]:
    """Plates, mirrors, handles."""
    half, w = design.half, design.size[1] / 2
    rear_z = 0.74 * design.belt
    pieces = [
        box((half - 0.05, -0.26, 0.36), (half + 0.012, 0.26, 0.46), PLATE),
        box((-half - 0.012, -0.26, rear_z - 0.06), (-half + 0.05, 0.26, rear_z + 0.06), PLATE),
    ]
    for side in (-1, 1):
        mirror = ellipsoid((0.075, 0.11, 0.065), PAINT, subdivisions=1)
        pieces.append(mirror.at(design.glass[3] - 0.28, side * (w + 0.02), design.belt + 0.10))
        for x in (-0.42, 0.52):
            low, high = sorted((side * (w - 0.03), side * (w + 0.012)))
            pieces.append(box((x, low, design.belt - 0.115), (x + 0.17, high, design.belt - 0.085), TRIM))
    return pieces


def face_forward(x: float, y: float, height: float, yaw: float = 0.0) -> NDArray[np.float64]:
    """``world_from_vehicle`` [4, 4] of a vehicle of this height that stands at (x, y) on the road."""
    c, s = np.cos(yaw), np.sin(yaw)
    return pose([[c, -s, 0], [s, c, 0], [0, 0, 1]], (x, y, height / 2))


def sample_surface(shape: Shape, palette: Palette, count: int, seed: int) -> VehiclePoints:
    """Points spread evenly by area over all of a car, with their paint and normals."""
    mesh = trimesh.Trimesh(shape.corners.reshape(-1, 3), np.arange(3 * len(shape)).reshape(-1, 3), process=False)
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)[:2]
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[faces], points)
    normals = np.einsum("nk,nkd->nd", weights, shape.normals[faces])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors = palette.colors()[shape.materials[faces]]
    return VehiclePoints(points.astype(np.float32), colors, normals.astype(np.float32), is_complete=True)
