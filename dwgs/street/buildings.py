"""Houses on both sides: walls with windows, cornices, roofs."""

from dataclasses import replace

import numpy as np
import trimesh

from dwgs.street.material import BRICK, PLASTER, SHOP, Material, Palette
from dwgs.street.shape import Shape, box

WALLS = (
    ((146, 82, 62), BRICK), ((122, 70, 58), BRICK), ((170, 118, 88), BRICK), ((178, 160, 132), BRICK),
    ((222, 206, 176), PLASTER), ((206, 178, 138), PLASTER), ((196, 204, 206), PLASTER),
    ((214, 190, 178), PLASTER), ((176, 190, 172), PLASTER), ((232, 226, 214), PLASTER),
    ((164, 178, 192), PLASTER), ((208, 152, 118), PLASTER),
)  # fmt: skip
FRAMES = ((238, 236, 230), (226, 222, 210), (60, 64, 66), (92, 72, 56), (236, 232, 222))
ROOFS = ((120, 66, 50), (86, 84, 88), (104, 92, 84))
STOREY = 3.05
GROUND_FLOOR = 3.7


def build_house(palette: Palette, x: float, front: float, width: float, rng: np.random.Generator) -> Shape:
    """A house on [x, x + width] whose front stands at y = front and looks at the road [m]."""
    facing = 1.0 if front < 0 else -1.0
    color, pattern = WALLS[rng.integers(len(WALLS))]
    frame = FRAMES[rng.integers(len(FRAMES))]
    bays = max(2, round(width / rng.uniform(2.1, 2.9)))
    storeys = int(rng.integers(2, 5))
    ground = GROUND_FLOOR + float(rng.uniform(-0.1, 0.4))
    top = ground + storeys * STOREY + 0.6
    back = front - facing * 12
    low, high = sorted((front, back))
    if pattern == PLASTER and rng.random() < 0.6:
        pattern = SHOP
    walls = Material(
        color,
        pattern,
        accent=frame,
        windows=(width / bays, STOREY, ground),
        origin=(x if facing > 0 else x + width, front, 0.0),
    )
    blank = palette.add(replace(walls, windows=(0.0, 0.0, 0.0)))
    is_pale = sum(frame) > 400
    stone = palette.add(Material((228, 222, 212) if is_pale else (198, 190, 178), PLASTER))
    pieces = [_fronted(box((x, low, 0), (x + width, high, top), blank), facing, palette.add(walls))]

    def ledge(z: float, height: float, reach: float) -> Shape:
        low, high = sorted((front - facing * 0.3, front + facing * reach))
        return box((x - 0.02, low, z), (x + width + 0.02, high, z + height), stone)

    pieces += [ledge(top - 0.28, 0.28, 0.32), ledge(top - 0.50, 0.22, 0.16), ledge(ground + 0.02, 0.16, 0.10)]
    low, high = sorted((front - facing * 0.3, front + facing * 0.05))
    plinth = palette.add(Material((120, 116, 110), PLASTER))
    pieces.append(box((x, low, 0), (x + width, high, 0.42), plinth))
    if rng.random() < 0.45:
        pieces.append(_roof(palette, (x, x + width), (min(front, back), max(front, back)), top, rng))
    if rng.random() < 0.5:
        pieces += _oriels(palette, walls, facing, range(int(rng.integers(0, 2)), bays, 2), storeys)
    return Shape.join(pieces)


def _roof(
    palette: Palette, x: tuple[float, float], y: tuple[float, float], z: float, rng: np.random.Generator
) -> Shape:
    """A ridge along the street, and a chimney."""
    tiles = palette.add(Material(ROOFS[rng.integers(len(ROOFS))], PLASTER))
    mid, rise = (y[0] + y[1]) / 2, float(rng.uniform(2.0, 3.2))
    corners = [[a, b, z] for a in x for b in y] + [[a, mid, z + rise] for a in x]
    hull = trimesh.convex.convex_hull(np.array(corners))
    chimney = box((x[0] + 1.2, mid - 2.4, z), (x[0] + 1.9, mid - 1.5, z + rise + 0.9), tiles)
    return Shape.join([Shape.of(hull, tiles), chimney])


def _oriels(palette: Palette, front: Material, facing: float, columns: range, storeys: int) -> list[Shape]:
    """Bay windows over all upper storeys, at the given columns of the front."""
    bay, storey, ground = front.windows
    x0, y0, _ = front.origin
    walls = palette.add(replace(front, pattern=PLASTER))
    blank = palette.add(replace(front, pattern=PLASTER, windows=(0.0, 0.0, 0.0)))
    pieces = []
    for column in columns:
        left, right = sorted((x0 + facing * (bay * column + 0.25), x0 + facing * (bay * (column + 1) - 0.25)))
        low, high = sorted((y0 - facing * 0.1, y0 + facing * 0.7))
        body = box((left, low, ground + 0.12), (right, high, ground + storeys * storey), blank)
        pieces.append(_fronted(body, facing, walls))
    return pieces


def _fronted(body: Shape, facing: float, front: int) -> Shape:
    """A box whose side towards the road has another material."""
    is_front = body.normals[:, 0, 1] * facing > 0.9
    return replace(body, materials=np.where(is_front, front, body.materials).astype(np.int32))
