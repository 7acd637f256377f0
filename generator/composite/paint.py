"""What a scanned vehicle looks like: colours where points tell, the common look of vehicles elsewhere.

Behind glass a LiDAR hits seats and the far side of the street, and a camera colours them with whatever it
mirrors. So windows are drawn where vehicles have them, and scan colours count below the belt.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.spatial import KDTree

from dwgs.scene import VehiclePoints
from dwgs.scene.color import linear_from_srgb, luminance
from generator.composite.solid import TYRE_WIDTH, VOXEL, Solid

GLASS, TYRE, RIM, SHADE = ((0.012, 0.014, 0.017), (0.014, 0.014, 0.015), (0.10, 0.10, 0.105), (0.005,) * 3)
"""Linear colours of a dark cabin behind glass, rubber, wheels, and what lies under a vehicle."""
MIRRORED = 0.04
"""A point of the other side counts as this much [m] further away than a side's own."""
REACH = 0.07
"""A point tells the colour of the surface over about this distance [m]."""
NEIGHBOURS = 32
"""Points that a colour is the average of: colours of a scan are noisy, projected from many frames."""
BELT = 0.11
"""Windows begin at this share of the height above the box centre."""
FRAME = 0.1
"""Width of pillars and of the roof's edge [m]."""


@dataclass(frozen=True)
class Paint:
    """Look of the vertices of a solid."""

    colors: NDArray[np.float64]
    """[V, 3] linear."""
    gloss: NDArray[np.float64]
    """[V] in [0, 1]: share of a clear coat's reflection that the colour does not contain yet."""
    evidence: NDArray[np.float64]
    """[V] in [0, 1]: how much of the colour was seen by a camera, light included."""


def paint(solid: Solid, vehicle: VehiclePoints, size: NDArray) -> Paint:
    """Colour a solid with the points it was made from."""
    points, normals = solid.vertices, solid.normals
    colors, evidence = _seen(vehicle, points)
    up = points[:, 2] / size[2]
    doors = (evidence > 0.6) & (np.abs(normals[:, 1]) > 0.8) & (np.abs(up) < 0.15)
    body = np.median(colors[doors], axis=0) if doors.any() else np.full(3, 0.2)
    evidence = np.where((up > BELT) & (normals[:, 2] < 0.85), 0.3 * evidence, evidence)  # pillars mirror, and are thin
    colors = evidence[:, None] * colors + (1 - evidence[:, None]) * body
    gloss = 0.6 * (1 - evidence)

    glass = windows(solid, size)
    colors, gloss, evidence = (
        np.where(glass[:, None], GLASS, colors),
        np.where(glass, 1.0, gloss),
        evidence * ~glass,
    )
    below = (normals[:, 2] < -0.5) & (up < -0.15)
    colors[below], gloss[below], evidence[below] = SHADE, 0, 0
    for wheel in solid.wheels:
        radius = np.hypot(points[:, 0] - wheel.x, points[:, 2] - wheel.z) / wheel.radius
        outer = np.abs(points[:, 1]) > wheel.outside - TYRE_WIDTH - 2 * VOXEL
        rim, tyre, gap = (outer & (radius >= a) & (radius < b) for a, b in ((0, 0.64), (0.64, 1.05), (1.05, 1.16)))
        tyre &= normals[:, 2] < 0.9
        colors[rim] = np.where(evidence[rim, None] > 0.5, colors[rim], RIM)
        colors[tyre], colors[gap] = TYRE, np.minimum(colors[gap], 3 * np.array(SHADE))
        gloss[rim | tyre | gap], evidence[tyre] = 0, 0
    return Paint(colors, gloss, evidence)


def windows(solid: Solid, size: NDArray) -> NDArray[np.bool_]:
    """Which vertices [V] of a solid are glass: sides, front and rear of what rises above the belt."""
    x, y, z = solid.vertices.T
    normals, belt = solid.normals, BELT * size[2]
    column = np.round((x - x.min()) / (2 * VOXEL)).astype(int)
    roof = np.full(column.max() + 1, -np.inf)
    np.maximum.at(roof, column, z)
    row = np.round((z - z.min()) / (2 * VOXEL)).astype(int)
    rear, front, half = (np.full(row.max() + 1, sign * np.inf) for sign in (1, -1, -1))
    np.minimum.at(rear, row, x)
    np.maximum.at(front, row, x)
    np.maximum.at(half, row, np.abs(y))
    # a pickup's bed or a long boot carries no roof: there the outline falls below the belt
    near = maximum_filter(roof, round(7 * FRAME / (2 * VOXEL)) | 1)
    steep = (z > belt) & (normals[:, 2] < 0.85)
    top = z.max() if len(z) else 0.0
    pillar = np.abs(x - (rear[row] + front[row]) / 2) < FRAME / 2
    framed = (x > rear[row] + 1.6 * FRAME) & (x < front[row] - 1.6 * FRAME) & ~pillar
    side = (np.abs(normals[:, 1]) > 0.6) & (z < roof[column] - 1.3 * FRAME) & framed & (roof[column] > belt + 3 * FRAME)
    across = (np.abs(normals[:, 0]) > 0.25) & (np.abs(normals[:, 1]) < 0.6)
    end = across & (np.abs(y) < half[row] - 1.2 * FRAME) & (z < top - 1.2 * FRAME) & (near[column] > belt + 3 * FRAME)
    return steep & (side | end)


def _seen(vehicle: VehiclePoints, points: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Linear colours [V, 3] that a scan and its mirror image give to points [V, 3], and how surely [V].

    The mirror image lies aside in a fourth dimension, so that each side prefers its own points. Neighbours
    far from the middle brightness count less: they are glints, or what lies behind.
    """
    own = np.pad(np.asarray(vehicle.points, np.float64), ((0, 0), (0, 1)))
    cloud = np.concatenate([own, own * (1, -1, 1, 1) + (0, 0, 0, MIRRORED)])
    light = linear_from_srgb(np.tile(vehicle.colors, (2, 1)) / 255.0)
    count = min(NEIGHBOURS, len(cloud))
    distance, index = KDTree(cloud).query(np.pad(points, ((0, 0), (0, 1))), count, workers=2)
    distance, index = distance.reshape(len(points), count), index.reshape(len(points), count)
    neighbours = light[index]
    brightness = luminance(neighbours)
    middle = np.median(brightness, axis=1, keepdims=True)
    reach = np.maximum(distance[:, 5:6], 0.02) if count > 5 else REACH  # sharp where the scan is dense
    weight = np.exp(-0.5 * (distance / reach) ** 2) / (1 + ((brightness - middle) / (0.5 * middle + 1e-3)) ** 2) + 1e-12
    colors = (weight[..., None] * neighbours).sum(1) / weight.sum(1, keepdims=True)
    evidence = np.clip(2 * np.exp(-0.5 * (np.quantile(distance, 0.25, axis=1) / REACH) ** 2) - 0.25, 0, 1)
    return colors, evidence
