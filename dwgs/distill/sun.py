"""Where the sun stands: the ground beside the vehicle tells, by how it is darkened, frame by frame.

A vehicle turns and the sun does not, so a shadow learnt in the vehicle's frame has to be cast anew as it turns. All
that this needs is the sun's direction, and how high above the ground each part of the shadow is cast from.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.distill.region import covered
from dwgs.distill.shots import Shot, Sight
from dwgs.scene import Casting, Gaussians, Insertion
from dwgs.scene.pose import transform_points

CELL = 0.15
"""Side [m] of a patch of ground."""
ALIKE = np.cos(np.radians(3))
"""Frames tell together where headings differ by less than the angle of this cosine."""
ENOUGH = 16
"""Frames that tell."""
POINTS = 3000
"""Points of the vehicle that cast its shadow."""
AZIMUTHS, SLOPES = 24, 8
"""Directions that are tried first."""
LOWEST = 0.15
"""Way [m] that a shadow reaches per metre of height, below which it hides under the vehicle."""
CONTACT = 0.3
"""So far around the box [m] the ground is dark under any sky."""
LEAST_SHADE = 20
"""Patches of ground that a shadow must have where the frames see them."""
LIKENESS = 0.5
"""Correlation of what is dark with what should be, below which no sun is believed in."""
NEIGHBOURS = 16
"""Points whose median height is that of what casts a Gaussian."""


def find_casting(shots: Sequence[Shot], insertion: Insertion, shadow: Gaussians, margin: float) -> Casting | None:
    """How the vehicle's shadow is cast, as it lies at the heading of most frames; None where no sun is seen.

    Args:
        shots: Frames with their backgrounds.
        insertion: The vehicle.
        shadow: Where its shadow may lie.
        margin: How far around the box [m]; no shadow reaches farther.
    """
    if len(shadow) == 0:
        return None
    at_rest = resting_pose([shot.sight for shot in shots])
    alike = [s for s in shots if at_rest[:3, 0] @ s.sight.world_from_vehicle[:3, 0] > ALIKE]
    places, shape = _ground(insertion.size, margin)
    darkness = _darkness(alike[:: -(-len(alike) // ENOUGH)], places, insertion)
    points = _above_ground(insertion)[:: len(insertion.vehicle.points) // POINTS + 1]
    clear = (np.abs(places[:, :2]) > insertion.size[:2] / 2 + CONTACT).any(1)
    seen = np.isfinite(darkness) & clear
    if not seen.any() or np.ptp(darkness[seen]) == 0:
        return None
    centred = darkness[seen] - darkness[seen].mean()
    centred /= np.linalg.norm(centred)

    def likeness(slope: NDArray) -> float:
        """The correlation of what is dark with what would be."""
        cast = _cast(points, slope, shape)[seen]
        if not LEAST_SHADE <= cast.sum() < len(cast):
            return 0.0
        share = cast.mean()
        return float(centred[cast].sum() / np.sqrt(len(cast) * share * (1 - share)))

    most = margin / insertion.size[2]
    slope, best = _search(likeness, most)
    if best < LIKENESS:
        return None
    sun = np.array([*-slope, 1.0]) / np.hypot(1.0, np.hypot(*slope))
    tree = KDTree(points[:, :2] + points[:, 2:] * slope)
    nearest = tree.query(shadow.means[:, :2], min(NEIGHBOURS, len(points)))[1].reshape(len(shadow), -1)
    heights = np.median(points[nearest, 2], axis=1).astype(np.float32)
    return Casting(at_rest[:3, :3] @ sun, sun, heights)


def resting_pose(sights: Sequence[Sight]) -> NDArray[np.float64]:
    """[4, 4] the pose whose heading is nearest to the median of all."""
    ahead = np.array([sight.world_from_vehicle[:3, 0] for sight in sights])
    nearest = int(np.argmin(((ahead - np.median(ahead, axis=0)) ** 2).sum(1)))
    return sights[nearest].world_from_vehicle


def turning(sights: Sequence[Sight]) -> float:
    """How far the end of a shadow of 1 m moves at most while the vehicle turns away from its resting pose [m]."""
    ahead = np.array([sight.world_from_vehicle[:2, 0] for sight in sights])
    return float(np.linalg.norm(ahead - resting_pose(sights)[:2, 0], axis=1).max())


def _above_ground(insertion: Insertion) -> NDArray[np.float64]:
    """[P, 3] the vehicle's points, heights from the ground."""
    points = np.array(insertion.vehicle.points, np.float64)
    points[:, 2] = np.clip(points[:, 2] + insertion.size[2] / 2, 0, insertion.size[2])
    return points


def _ground(size: NDArray, margin: float) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """Middles [P, 3] of patches of ground around the box in the vehicle's frame; how many there are each way."""
    counts = np.ceil((np.asarray(size[:2]) / 2 + margin) / CELL).astype(int)
    x, y = (CELL * (np.arange(-n, n) + 0.5) for n in counts)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    return np.column_stack([grid, np.full(len(grid), -size[2] / 2)]), (len(x), len(y))


def _darkness(shots: Sequence[Shot], places: NDArray, insertion: Insertion) -> NDArray[np.float64]:
    """[P] share of its brightness that a place lost, a mean over the frames; NaN where none sees it."""
    lost, seen = np.zeros((2, len(places)))
    for shot in shots:
        sight = shot.sight
        region, camera = sight.region, sight.region.window.camera(sight.camera)
        pixels, depth = camera.project(transform_points(sight.world_from_vehicle, places))
        inside = camera.contains(pixels) & (depth > 0)
        column, row = np.floor(pixels[inside]).astype(int).T
        told = region.supervised | (region.bare & region.reactive.any())
        told &= ~covered(camera, sight.world_from_vehicle, insertion)
        with torch.no_grad():
            alone = shot.frozen.alone(shot.view).mean(2).numpy()
        ratio = shot.target.mean(2).numpy() / np.maximum(alone, 0.05)
        counts = told[row, column]
        index = np.flatnonzero(inside)[counts]
        lost[index] += 1 - np.minimum(ratio[row, column], 1)[counts]
        seen[index] += 1
    with np.errstate(invalid="ignore"):
        return lost / seen


def _cast(points: NDArray, slope: NDArray, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """[P] patches of ground in the shadow of ``points`` (heights from the ground)."""
    cells = np.floor((points[:, :2] + points[:, 2:] * slope) / CELL).astype(int) + np.array(shape) // 2
    cells = cells[((cells >= 0) & (cells < shape)).all(1)]
    shaded = np.zeros(shape, bool)
    shaded[tuple(cells.T)] = True
    return shaded.reshape(-1)


def _search(likeness, most: float) -> tuple[NDArray[np.float64], float]:
    """The slope [2] up to ``most`` of the greatest likeness, and that."""
    azimuths = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    best = max(
        (likeness(length * np.array([np.cos(a), np.sin(a)])), a, np.log(length))
        for a in azimuths
        for length in np.geomspace(LOWEST, most, SLOPES)
    )
    step = np.array([np.pi / AZIMUTHS, np.log(most / LOWEST) / SLOPES / 2])
    for _ in range(4):
        around = [
            (best[1] + i * step[0], min(best[2] + j * step[1], np.log(most))) for i in (-1, 0, 1) for j in (-1, 0, 1)
        ]
        best = max(best, *((likeness(np.exp(b) * np.array([np.cos(a), np.sin(a)])), a, b) for a, b in around))
        step = step / 2
    return np.exp(best[2]) * np.array([np.cos(best[1]), np.sin(best[1])]), best[0]
