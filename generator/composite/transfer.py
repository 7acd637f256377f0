"""Who sees which light: a vehicle's discs, and the ground around it (radiance transfer, Sloan et al. 2002).

Both are sums over directions of what the vehicle itself leaves free, found once, in its own frame. Whatever light
it drives through later is a matrix product.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, gaussian_filter

from generator.composite.surface import Surface

DISC_DIRECTIONS, GROUND_DIRECTIONS = 64, 160
"""Directions that light comes from: over the sphere for discs, over the upper half for the ground."""
CELL = 0.04
"""Grid step of depth maps and of the ground [m]."""
BIAS = 0.06
"""A disc this much behind the front of its cell [m] still belongs to it."""
CASTERS = 50_000
"""Discs that cast the shadow on the ground: still closer than its cells."""
REACH = 2.5
"""The ground is followed so far from the box [m]."""


class Transfer:
    """What a surface on the ground leaves of the light, for itself and for the ground."""

    def __init__(self, surface: Surface, size: NDArray) -> None:
        self.surface = surface
        self.size = np.asarray(size, np.float64)
        self.directions = _sphere(DISC_DIRECTIONS)
        """[D, 3] unit, towards the light, vehicle frame; the upper half comes first."""
        self.ground_directions = _sphere(2 * GROUND_DIRECTIONS)[:GROUND_DIRECTIONS]
        """[G, 3] likewise, above the horizon."""
        self.ground_shape = tuple(np.ceil((self.size[:2] + 2 * REACH) / CELL).astype(int))

    @cached_property
    def discs(self) -> NDArray[np.float32]:
        """[N, D]: light a disc gets from each direction, as a share of what a free disc gets in all."""
        cosine = np.maximum(self.surface.normals @ self.directions.T, 0) * np.float32(4 / DISC_DIRECTIONS)
        for d, direction in enumerate(self.directions):
            cosine[:, d] *= self.sees(direction)
        return cosine

    @cached_property
    def ground(self) -> NDArray[np.float32]:
        """[G, X, Y]: 1 where the vehicle hides a direction from the ground, in cells of `CELL`."""
        return np.stack([self.shadow(direction) for direction in self.ground_directions])

    def sees(self, direction: NDArray) -> NDArray[np.bool_]:
        """Whether each disc [N] has a free way in that direction [3], vehicle frame."""
        points = self.surface.points
        direction = np.asarray(direction, np.float32)
        u_axis = np.cross(direction, np.eye(3, dtype=np.float32)[np.argmin(np.abs(direction))])
        u_axis /= np.linalg.norm(u_axis)
        u, v, depth = points @ u_axis, points @ np.cross(direction, u_axis), points @ direction
        i, j = ((u - u.min()) / CELL).astype(int), ((v - v.min()) / CELL).astype(int)
        cell = i * (j.max() + 1) + j
        front = np.full(cell.max() + 1, -np.inf, np.float32)
        np.maximum.at(front, cell, depth)
        facing = np.clip(np.abs(self.surface.normals @ direction), 0.15, 1)
        return depth > front[cell] - BIAS - CELL * np.sqrt(1 - facing**2) / facing

    def shadow(self, direction: NDArray) -> NDArray[np.float32]:
        """[X, Y]: 1 where the vehicle shades the ground from light in that direction [3], vehicle frame."""
        points = self.surface.points[:: -(-len(self.surface.points) // CASTERS)]
        height = points[:, 2] + self.size[2] / 2
        xy = points[:, :2] - height[:, None] * (direction[:2] / max(direction[2], 0.05))
        cells = np.floor((xy + self.size[:2] / 2 + REACH) / CELL).astype(int)
        cells = cells[(cells >= 0).all(1) & (cells < self.ground_shape).all(1)]
        hit = np.zeros(self.ground_shape, bool)
        hit[tuple(cells.T)] = True
        return binary_closing(hit, iterations=2).astype(np.float32)


def soften(shadow: NDArray, sigma: float) -> NDArray:
    """A ground map [X, Y] blurred by ``sigma`` [m], and faded out towards the border of the map."""
    edge = [
        np.clip(np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) * CELL / (0.5 * REACH), 0, 1)
        for n in shadow.shape
    ]
    return gaussian_filter(shadow, sigma / CELL) * edge[0][:, None] * edge[1]


def _sphere(count: int) -> NDArray[np.float32]:
    """Evenly spread unit vectors [count, 3], from the pole down: a Fibonacci sphere."""
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    rho = np.sqrt(1 - z * z)
    return np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], -1).astype(np.float32)
