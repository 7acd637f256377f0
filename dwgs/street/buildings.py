"""Houses on both sides: walls with windows, cornices, roofs."""

import numpy as np
import trimesh

from dwgs.street.material import BRICK, PLASTER, SHOP, Material, Palette
from dwgs.street.shape import Shape, box

WALLS = (
    ((146, 82, 62), BRICK), ((122, 70, 58), BRICK), ((170, 118, 88), BRICK), ((178, 160, 132), BRICK),
    ((222, 206, 176), PLASTER), ((206, 178, 138), PLASTER), ((196, 204, 206), PLASTER), ((214, 190, 178), PLASTER),
    ((176, 190, 172), PLASTER), ((232, 226, 214), PLASTER), ((164, 178, 192), PLASTER), ((208, 152, 118), PLASTER),
)  # fmt: skip
FRAMES = ((238, 236, 230), (226, 222, 210), (60, 64, 66), (92, 72, 56), (236, 232, 222))
ROOFS = ((120, 66, 50), (86, 84, 88), (104, 92, 84))
STOREY = 3.05
GROUND_FLOOR = 3.7


def build_house(palette: Palette, x: float, front: float, width: float, rng: np.random.Generator) -> Shape:
    """A house on [x, x + width] whose front stands at y = front and looks at the road, which lies near y = 3 [m]."""
    facing = 1.0 if front < 0 else -1.0
    color, pattern = WALLS[rng.integers(len(WALLS))]
    frame = FRAMES[rng.integers(len(FRAMES))]
    bays = max(2, round(width / rng.uniform(2.1, 2.9)))
    storeys = int(rng.integers(2, 5))
    ground = GROUND_FLOOR + float(rng.uniform(-0.1, 0.4))
    top = ground + storeys * STOREY + 0.6
    origin = (x if facing > 0 else x + width, front, 0.0)
    is_shop = rng.random() < 0.45
    back = front - facing * 12

    windows = (width / bays, STOREY, ground)
    blank = palette.add(Material(color, pattern, origin=origin))
    walls = palette.add(
        Material(
            color, SHOP if is_shop and pattern == PLASTER else pattern, frame, windows=windows, origin=origin
        )
    )
    stone = palette.add(
        Material(tuple(int(0.5 * c + 112) for c in frame) if sum(frame) > 400 else (198, 190, 178), PLASTER)
    )
    body = box((x, min(front, back), 0), (x + width, max(front, back), top), blank)
    is_front = body.normals[:, 0, 1] * facing > 0.9
    pieces = [Shape(body.corners, body.normals, np.where(is_front, walls, blank).astype(np.int32))]

    def ledge(z: float, height: float, reach: float) -> Shape:
        low, high = sorted((front - facing * 0.3, front + facing * reach))
        return box((x - 0.02, low, z), (x + width + 0.02, high, z + height), stone)

    pieces += [ledge(top - 0.28, 0.28, 0.32), ledge(top - 0.50, 0.22, 0.16), ledge(ground + 0.02, 0.16, 0.10)]
    low, high = sorted((front - facing * 0.3, front + facing * 0.05))
    plinth = palette.add(Material((120, 116, 110), PLASTER))
    pieces.append(box((x, low, 0), (x + width, high, 0.42), plinth))
    if rng.random() < 0.45:
        pieces.append(_roof(palette, (x, x + width), sorted((front, back)), top, rng))
    if rng.random() < 0.5:
        pieces += _oriels(palette, origin, facing, windows, storeys, color, frame, rng)
    return Shape.join(pieces)


def _roof(
    palette: Palette, x: tuple[float, float], y: list[float], z: float, rng: np.random.Generator
) -> Shape:
    """A ridge along the street, and a chimney."""
    tiles = palette.add(Material(ROOFS[rng.integers(len(ROOFS))], PLASTER))
    mid, rise = (y[0] + y[1]) / 2, float(rng.uniform(2.0, 3.2))
    corners = [[a, b, z] for a in x for b in y] + [[a, mid, z + rise] for a in x]
    hull = trimesh.convex.convex_hull(np.array(corners))
    chimney = box((x[0] + 1.2, mid - 2.4, z), (x[0] + 1.9, mid - 1.5, z + rise + 0.9), tiles)
    return Shape.join([Shape.of(hull, tiles), chimney])


def _oriels(palette, origin, facing, windows, storeys, color, frame, rng) -> list[Shape]:
    """Bay windows that stand out from every other column of the upper storeys."""
    bay, storey, ground = windows
    x0, front, _ = origin
    depth = 0.7
    pieces = []
    start = int(rng.integers(0, 2))
    count = max(2, round(abs(bay) and 4))
    for column in range(start, count, 2):
        edge = x0 + facing * bay * column
        xs = sorted((edge + facing * 0.25, edge + facing * (bay - 0.25)))
        ys = sorted((front - facing * 0.1, front + facing * depth))
        z = (ground + 0.12, ground + storeys * storey)
        walls = palette.add(Material(color, PLASTER, frame, windows=(bay, storey, ground), origin=origin))
        blank = palette.add(Material(color, PLASTER, origin=origin))
        body = box((xs[0], ys[0], z[0]), (xs[1], ys[1], z[1]), blank)
        is_front = body.normals[:, 0, 1] * facing > 0.9
        pieces.append(Shape(body.corners, body.normals, np.where(is_front, walls, blank).astype(np.int32)))
    return pieces
