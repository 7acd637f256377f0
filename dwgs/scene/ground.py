"""How high the ground is, from what the LiDAR hit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.lidar import SURFACES, LidarSweep
from dwgs.scene.trajectory import Trajectory

CELL = 0.5
"""Spacing [m] of the height grid: finer than a wheelbase, coarse enough to hold points far away."""
REACH = 80.0
"""How far [m] from the ego path ground is looked for; beyond, its plane goes on."""

_SWEEPS = 16
_OUTLIER = 0.15
_BLUR = np.array([1, 4, 6, 4, 1]) / 16


@dataclass(frozen=True)
class Ground:
    """A plane and, near the road, how far the ground departs from it."""

    plane: NDArray[np.float64]
    """[3] (a, b, c): z = a x + b y + c [m]."""
    corner: NDArray[np.float64]
    """[2] world position of ``relief[0, 0]`` [m]."""
    relief: NDArray[np.float64]
    """[Y, X] height above the plane [m], `CELL` apart along world y and x."""

    @staticmethod
    def from_sweeps(sweeps: Sequence[LidarSweep], ego: Trajectory) -> "Ground":
        """Ground around the ego path: per cell the middle of what is labelled ground, else the lowest points.

        Cells that stick out of their surroundings (a car roof, a facade) are dropped, cells without points
        filled from their neighbours. Raises `InputError` without sweeps or without points near the path.
        """
        path = ego.world_from_vehicle[:, :2, 3]
        low, high = path.min(0) - REACH, path.max(0) + REACH
        columns, rows = np.ceil((high - low) / CELL).astype(int)
        chosen = np.unique(np.linspace(0, len(sweeps) - 1, _SWEEPS).round().astype(int)) if sweeps else []
        clouds = [_candidates(sweeps[i], low, high, ego) for i in chosen]
        points = np.concatenate([np.empty((0, 3)), *(cloud for cloud, _ in clouds)])
        if len(points) < 3:
            raise InputError("the ground is found in LiDAR points near the ego path, this scene has none")
        is_labelled = all(labelled for _, labelled in clouds)
        x, y = ((points[:, :2] - low) / CELL).astype(int).T
        cells, heights = _quantile_by_cell(y * columns + x, points[:, 2], 0.5 if is_labelled else 0.1)
        centres = low + (np.stack([cells % columns, cells // columns], 1) + 0.5) * CELL
        plane = _fit_plane(centres, heights)
        relief, weight = np.zeros(rows * columns), np.zeros(rows * columns)
        relief[cells] = heights - centres @ plane[:2] - plane[2]
        weight[cells] = 1
        relief, weight = relief.reshape(rows, columns), weight.reshape(rows, columns)
        for _ in range(3):  # what sticks out lifts its surroundings: look again once it is gone
            weight[relief > _surroundings(relief, weight) + _OUTLIER] = 0
        return Ground(plane, low + CELL / 2, _blur(_fill(relief, weight)))

    def height(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Height [...] of the ground [m] at world positions [..., 2]."""
        xy = np.asarray(xy, np.float64)
        column, row = np.moveaxis((xy - self.corner) / CELL, -1, 0)
        return _bilinear(self.relief, row, column) + xy @ self.plane[:2] + self.plane[2]

    def normal(self, xy: ArrayLike) -> NDArray[np.float64]:
        """Unit normal [..., 3] of the ground at world positions [..., 2]."""
        xy = np.asarray(xy, np.float64)
        dx, dy = ((self.height(xy + step) - self.height(xy - step)) / (2 * CELL) for step in ([CELL, 0], [0, CELL]))
        normal = np.stack([-dx, -dy, np.ones_like(dx)], -1)
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _candidates(sweep: LidarSweep, low: NDArray, high: NDArray, ego: Trajectory) -> tuple[NDArray[np.float64], bool]:
    """Points [P, 3] that may be ground, and whether labels say so."""
    points = sweep.points.astype(np.float64)
    inside = ((points[:, :2] > low) & (points[:, :2] < high)).all(1)
    if sweep.labels is not None:
        return points[inside & (sweep.labels == SURFACES.index("ground"))], True
    points = points[inside]
    distance = np.linalg.norm(points[:, :2] - ego.at(sweep.time)[:2, 3], axis=1)
    near = points[distance < 15, 2]
    floor = np.quantile(near, 0.05) if len(near) else points[:, 2].min(initial=0)
    return points[abs(points[:, 2] - floor) < 0.5 + 0.08 * distance], False  # streets climb less than 8 %


def _quantile_by_cell(cell: NDArray, z: NDArray, q: float) -> tuple[NDArray, NDArray]:
    """Cells that occur, and the ``q`` quantile of ``z`` in each."""
    order = np.lexsort((z, cell))
    cells, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    return cells, z[order][first + np.round(q * (count - 1)).astype(int)]


def _fit_plane(xy: NDArray, z: NDArray) -> NDArray[np.float64]:
    """Least squares, twice: the second time without what lies far off the first."""
    design = np.column_stack([xy, np.ones(len(xy))])
    plane = np.linalg.lstsq(design, z, rcond=None)[0]
    error = abs(design @ plane - z)
    kept = error <= 2 * np.median(error) + 1e-9
    return np.asarray(np.linalg.lstsq(design[kept], z[kept], rcond=None)[0], np.float64)


def _fill(values: NDArray, weight: NDArray) -> NDArray[np.float64]:
    """Values where ``weight`` > 0; elsewhere what ever coarser averages of them say (pull-push)."""
    if (weight > 0).all() or values.size == 1:
        return np.where(weight > 0, values, 0)
    return np.where(weight > 0, values, _finer(_fill(*_coarser(values, weight)), values.shape))


def _surroundings(values: NDArray, weight: NDArray) -> NDArray[np.float64]:
    """Averages over areas larger than a parked car."""
    coarse, weight = _coarser(values, weight)
    coarser = _blur(_fill(*_coarser(coarse, weight)))
    return _finer(_finer(coarser, coarse.shape), values.shape)


def _coarser(values: NDArray, weight: NDArray) -> tuple[NDArray, NDArray]:
    """Averages of two by two cells, and whether any of the four weighs anything."""
    odd = [(0, n % 2) for n in values.shape]
    total, count = (
        sum(np.pad(grid, odd)[i::2, j::2] for i in (0, 1) for j in (0, 1)) for grid in (values * weight, weight)
    )
    return total / np.maximum(count, 1e-12), np.minimum(count, 1)


def _finer(coarse: NDArray, shape: tuple[int, ...]) -> NDArray[np.float64]:
    row, column = np.mgrid[: shape[0], : shape[1]]
    return _bilinear(coarse, (row - 0.5) / 2, (column - 0.5) / 2)


def _blur(grid: NDArray) -> NDArray[np.float64]:
    for axis in (0, 1):
        padded = np.pad(grid, [(2, 2) if a == axis else (0, 0) for a in (0, 1)], mode="edge")
        count = grid.shape[axis]
        shifted = [padded.take(np.arange(k, k + count), axis) for k in range(len(_BLUR))]
        grid = np.tensordot(_BLUR, shifted, 1)
    return grid


def _bilinear(grid: NDArray, row: NDArray, column: NDArray) -> NDArray[np.float64]:
    """``grid`` between its nodes; held still beyond its edges."""
    row = np.clip(row, 0, grid.shape[0] - 1)
    column = np.clip(column, 0, grid.shape[1] - 1)
    i = np.minimum(row.astype(int), max(grid.shape[0] - 2, 0))
    j = np.minimum(column.astype(int), max(grid.shape[1] - 2, 0))
    k, m = np.minimum(i + 1, grid.shape[0] - 1), np.minimum(j + 1, grid.shape[1] - 1)
    v, u = row - i, column - j
    return (1 - v) * ((1 - u) * grid[i, j] + u * grid[i, m]) + v * ((1 - u) * grid[k, j] + u * grid[k, m])
