"""Where the sun stands: from where the shadows of what the LiDAR hit would make the dark ground dark."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.scene import Frame, Scene
from dwgs.scene.color import linear_from_srgb, luminance
from dwgs.scene.ground import Ground

REACH = 30.0
"""Ground and obstacles so far from the LiDAR [m] count: further away returns are too sparse to cast a shadow."""
CELL = 0.3
"""Shadows are compared on a grid of this step [m]."""
FLAT, LOW, HIGH = 0.12, 0.3, 6.0
"""Heights [m]: below the first is ground, between the others is what casts shadows."""
OBSTACLES = 15_000
"""Returns of a sweep that cast shadows at most."""
AZIMUTHS, ELEVATIONS = np.radians(np.arange(0, 360, 10)), np.radians(np.arange(15, 80, 10))
"""Where the sun is looked for first."""
BESIDE = 0.6
"""Ground within this distance [m] of an obstacle does not tell whether there is a sun."""
CERTAIN = 0.2
"""A correlation below this, between predicted shadows and dark ground, is chance, or the dark under parked cars."""
BRIGHTER = 2.3
"""Sunlit ground is so many times brighter than shaded ground at least; less is old and new asphalt."""


@dataclass(frozen=True)
class Sun:
    """A sun that casts shadows."""

    direction: NDArray[np.float32]
    """[3] unit, towards the sun, world frame."""
    shaded: NDArray[np.float32]
    """[3] linear colour of the road in shadow."""
    sunlit: NDArray[np.float32]
    """[3] linear colour of the road in the sun."""


@dataclass(frozen=True)
class _Look:
    """One sweep and the colours of its ground."""

    ground: NDArray[np.float64]
    """[G, 2] world [m]."""
    colors: NDArray[np.float32]
    """[G, 3] linear."""
    obstacles: NDArray[np.float64]
    """[P, 3] world xy and height above the ground [m]."""
    clear: NDArray[np.bool_]
    """[G] whether no obstacle stands right beside the point: there it is dark under any sky."""

    def shaded(self, direction: NDArray) -> NDArray[np.bool_]:
        """Which ground points [G] the obstacles shade from a light in that direction [3]."""
        fallen = self.obstacles[:, :2] - self.obstacles[:, 2:] * (direction[:2] / direction[2])
        corner = self.ground.min(0)
        cells, shape = ((p - corner) / CELL for p in (fallen, self.ground)), np.ptp(self.ground, 0) / CELL + 1
        fallen, ground = (np.floor(c).astype(int) for c in cells)
        hit = np.zeros(shape.astype(int), bool)
        inside = ((fallen >= 0) & (fallen < hit.shape)).all(1)
        hit[tuple(fallen[inside].T)] = True
        return hit[tuple(ground.T)]


def find_sun(scene: Scene, frames: list[Frame]) -> Sun | None:
    """The sun of a drive, from a few of its frames; None where no direction explains the shadows well."""
    looks = _looks(scene, frames)
    if not looks:
        return None
    dark = [-np.log(luminance(look.colors) + 0.01) for look in looks]
    first = [(_fit(looks, dark, _direction(a, e)), a, e) for a in AZIMUTHS for e in ELEVATIONS]
    _, azimuth, elevation = max(first)
    steps = np.radians([-6, -3, 0, 3, 6])
    best, azimuth, elevation = max(
        (_fit(looks, dark, _direction(azimuth + a, elevation + e)), azimuth + a, elevation + e)
        for a in steps
        for e in steps
    )
    direction = _direction(azimuth, elevation)
    clear = np.concatenate([look.clear for look in looks])
    in_shadow = np.concatenate([look.shaded(direction) for look in looks])
    if best < CERTAIN or not (in_shadow & clear).any():
        return None
    colors = np.concatenate([look.colors for look in looks])
    shaded = np.median(colors[in_shadow & clear], axis=0)
    sunlit = np.median(colors[~in_shadow & clear], axis=0)
    if luminance(sunlit) < BRIGHTER * luminance(shaded):
        return None
    return Sun(direction.astype(np.float32), shaded, sunlit)


def _looks(scene: Scene, frames: list[Frame]) -> list[_Look]:
    sweeps = {s.frame_index: s for s in scene.sweeps}
    frames = [f for f in frames if f.index in sweeps]
    if not frames:
        return []
    relief, looks = Ground.from_sweeps(scene.sweeps, scene.ego), []
    for frame in frames:
        sweep, camera = sweeps[frame.index], frame.camera
        points = sweep.points.astype(np.float64)
        points = points[np.linalg.norm(points[:, :2] - sweep.origin[:2], axis=1) < REACH]
        height = points[:, 2] - relief.height(points[:, :2])
        floor = points[np.abs(height) < FLAT]
        uv, depth = camera.project(floor)
        visible = (depth > 1) & camera.contains(uv)
        tall = (height > LOW) & (height < HIGH)
        if not tall.any():
            continue
        clear = KDTree(points[tall, :2]).query(floor[:, :2], distance_upper_bound=BESIDE)[0] > BESIDE
        column, row = uv[visible].astype(int).T
        if visible.sum() > 100:
            colors = linear_from_srgb(frame.pixels[row, column] / np.float32(255))
            obstacles = np.column_stack([points, height])[tall][:: -(-tall.sum() // OBSTACLES)]
            looks.append(_Look(floor[visible, :2], colors, obstacles[:, (0, 1, 3)], clear[visible]))
    return looks


def _direction(azimuth: float, elevation: float) -> NDArray[np.float64]:
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _fit(looks: list[_Look], dark: list[NDArray], direction: NDArray) -> float:
    """Correlation of predicted shadow with darkness over all ground points; 0 where either does not vary."""
    shadow = np.concatenate([look.shaded(direction) for look in looks]).astype(np.float64)
    darkness = np.concatenate(dark)
    shadow, darkness = shadow - shadow.mean(), darkness - darkness.mean()
    spread = np.sqrt((shadow**2).sum() * (darkness**2).sum())
    return float((shadow * darkness).sum() / spread) if spread > 0 else 0.0
