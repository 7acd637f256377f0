"""Wheels are found by their turning: what comes round in step with the way driven, by harmonic of the angle.

Along rings about a hub, on the vehicle's side, brightness is a function of the angle, whose m-th harmonic goes round m
times as the wheel turns once. Let a_k be that of frame k, before which the hub has come forward by s_k. If and only if
hub, radius and m are right, all a_k exp(i m s_k / radius) are alike: a periodogram over the way. Frames in a wrong
order tell how alike they are by chance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from dwgs.distill.shots import Shot
from dwgs.scene import Trajectory
from dwgs.scene.silhouette import NEAR
from dwgs.splat import View

RADII = np.linspace(0.29, 0.4, 56)
"""Of wheels that cars have [m]."""
SPOKES = np.arange(3, 13)
"""Harmonics that may be a wheel's."""
RINGS = np.linspace(0.07, 0.23, 7)
"""Radii [m] between the cap and the rim of any wheel."""
ANGLES = np.arange(48) / 48 * 2 * np.pi
"""Along a ring: as a wheel rolls ahead, what is at one comes to a greater one."""
ALONG, ABOVE = (0.22, 0.38), (0.26, 0.46)
"""Where hubs may be: shares of the length before and behind the centre, and heights above the box's floor [m]."""
INWARD = np.array([0.0, 0.05, 0.1, 0.15])
"""How far within the side of the box the face of a wheel may be [m]."""
GRID, STEPS = 0.04, (0.02, 0.01, 0.005)
"""Distance of the hubs that are tried first, and by which the best are moved then [m]."""
NEARBY = 0.004
"""How far from the best radius it is looked for more finely [m]."""
LEAST_SCALE = 10.0
"""Pixels per metre along the side that show spokes."""
FEWEST, MOST = 6, 24
"""So many frames can tell, and need not be more."""
SHUFFLES = 8
"""Wrong orders of the frames that are tried."""
SURE = 1.5
"""Times what the best of them makes alike. Right orders of what does not turn, but drifts, have made 1.56."""
ALIGNED = 0.04
"""How much [m] axles may differ in height, and the faces of wheels in their distance from the middle."""


@dataclass(frozen=True)
class Look:
    """A frame that shows a side."""

    shot: Shot
    view: View
    """From where the pose was corrected to."""
    scale: float
    """Pixels per metre along the side."""

    @property
    def time(self) -> float:
        """[s]."""
        return self.shot.sight.frame.camera.time

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Brightness [...] at points [..., 3] of the vehicle."""
        matrix = self.view.viewmat.double().numpy()
        x, y, z = np.moveaxis(points @ matrix[:3, :3].T + matrix[:3, 3], -1, 0)
        fx, fy, cx, cy = self.view.lenses[0].tolist()
        z = np.maximum(z, NEAR)
        places = fy * y / z + cy - 0.5, fx * x / z + cx - 0.5
        return map_coordinates(self._brightness, places, order=1, mode="nearest")

    @cached_property
    def _brightness(self) -> NDArray[np.float32]:
        """[h, w]."""
        return self.shot.target.mean(-1).numpy()


@dataclass(frozen=True)
class Rolling:
    """What is known of the wheels on the side that is seen better."""

    trajectory: Trajectory
    """Where the vehicle drove."""
    looks: tuple[Look, ...]
    """Frames that show them."""
    hubs: NDArray[np.float64]
    """[2, 3] front and rear, on the faces of the wheels [m]."""
    radius: float
    """[m]."""
    spokes: int
    """Turned by one of so many parts a wheel looks the same."""
    phases: NDArray[np.float64]
    """[2] angles [rad] by which each is turned when nothing is driven yet, if they are one wheel."""
    evidence: float
    """How many times more is alike than by chance."""
    is_other_side_seen: bool
    """Whether any frame shows the other side."""

    def report(self) -> dict[str, Any]:
        """JSON values."""
        return {"radius_m": round(self.radius, 4), "spokes": self.spokes, "evidence": round(self.evidence, 2)}

    def angles(self, time: float) -> NDArray[np.float64]:
        """[2] by which they are turned at a ``time`` [s]."""
        return np.array([self.trajectory.driven(time, hub) for hub in self.hubs]) / self.radius + self.phases


def find_wheels(shots: Sequence[tuple[Shot, View]], size: NDArray, trajectory: Trajectory, seed: int) -> Rolling | None:
    """The wheels of a vehicle of ``size`` [3] [m]; None where nothing turns with the way, or frames are too few.

    Args:
        shots: Frames that teach, with their views of the vehicle where its poses are corrected.
        size: Of the box.
        trajectory: With the same corrections.
        seed: Of the wrong orders.
    """
    side, shown, is_other_side_seen = _best_side(shots, size)
    looks = [look for look in shown if look.scale > LEAST_SCALE][:MOST]
    if len(looks) < FEWEST:
        return None
    length, width, height = size
    x = np.arange(ALONG[0] * length, ALONG[1] * length, GRID)
    z = np.arange(*ABOVE, GRID) - height / 2
    front = np.stack(np.meshgrid(x, side * (width / 2 - INWARD), z, indexing="ij"), -1).reshape(-1, 3)
    tried = np.stack([front, front * [-1, 1, 1]])  # [end, hubs, 3]
    harmonics = np.stack([[_harmonics(looks, hub) for hub in hubs] for hubs in tried])
    ways = trajectory.driven([look.time for look in looks])

    def alike(ways: NDArray[np.float64]) -> NDArray[np.float64]:
        """[end, hubs, radii, spokes]."""
        return np.stack([_alike(of_end, ways, RADII) for of_end in harmonics])

    random, right = np.random.default_rng(seed), alike(ways)
    both = right.max(1).sum(0)
    chance = max(alike(random.permutation(ways)).max(1).sum(0).max() for _ in range(SHUFFLES))
    if both.max() < SURE * chance:
        return None
    r, m = np.unravel_index(both.argmax(), both.shape)
    about = [
        _refined(looks, ways, _hubs_of(tried, right, radius, spokes), radius, spokes)
        for radius, spokes in _as_often(float(RADII[r]), int(SPOKES[m]))
    ]
    best = max(about, key=lambda wheels: wheels.alike)
    if np.abs(best.hubs[0] - best.hubs[1])[1:].max() > ALIGNED:
        return None
    phases = _phases(looks, trajectory, best.hubs, best.radius, best.spokes)
    evidence = float(both.max() / chance)
    return Rolling(trajectory, tuple(shown), best.hubs, best.radius, best.spokes, phases, evidence, is_other_side_seen)


def are_wheels_seen(shots: Sequence[tuple[Shot, View]], size: NDArray) -> bool:
    """Whether enough frames show a side well enough to look for wheels there."""
    return sum(look.scale > LEAST_SCALE for look in _best_side(shots, size)[1]) >= FEWEST


def _best_side(shots: Sequence[tuple[Shot, View]], size: NDArray) -> tuple[int, list[Look], bool]:
    """The side that is seen better (1: left, -1: right), looks, the sharpest first, and whether the other is seen."""
    sides = {side: _looks(shots, size, side) for side in (1, -1)}
    side = max(sides, key=lambda s: sum(look.scale for look in sides[s]))
    return side, sorted(sides[side], key=lambda look: -look.scale), bool(sides[-side])


def _looks(shots: Sequence[tuple[Shot, View]], size: NDArray, side: int) -> list[Look]:
    """The frames that show a side of the box: the left, 1, or the right, -1."""
    middle, looks = np.array([0, side * size[1] / 2, -size[2] / 4]), []
    for shot, view in shots:
        matrix = view.viewmat.double().numpy()
        away = -matrix[:3, :3].T @ matrix[:3, 3] - middle
        scale = float(view.lenses[0, 0]) * side * away[1] / (away @ away)
        if scale > 0:
            looks.append(Look(shot, view, scale))
    return looks


def _harmonics(looks: Sequence[Look], hub: NDArray[np.float64]) -> NDArray[np.complex64]:
    """[looks, rings, spokes] of brightness about a hub, without what is the same in all, as shares of all of them."""
    around = np.stack([np.cos(ANGLES), 0 * ANGLES, -np.sin(ANGLES)], -1)
    points = hub + RINGS[:, None, None] * around
    seen = np.stack([look.at(points) for look in looks])
    seen -= seen.mean(2, keepdims=True)
    seen /= np.sqrt((seen**2).mean((1, 2), keepdims=True)) + 1e-6
    seen -= seen.mean(0)
    harmonics = np.fft.rfft(seen, axis=2)
    return (harmonics[..., SPOKES] / np.sqrt((np.abs(harmonics) ** 2).sum() + 1e-12)).astype(np.complex64)


def _alike(harmonics: NDArray, ways: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.float64]:
    """[hubs, radii, spokes] share of all that turns about hubs as a wheel of such a radius and so many spokes does."""
    hubs, frames, rings, _ = harmonics.shape
    alike = np.empty((hubs, len(radii), len(SPOKES)))
    for j, m in enumerate(SPOKES):
        back = np.exp(1j * m * np.outer(1 / radii, ways)).astype(np.complex64)
        means = back @ harmonics[..., j].transpose(1, 0, 2).reshape(frames, -1)
        alike[..., j] = (np.abs(means) ** 2).reshape(len(radii), hubs, rings).sum(2).T / frames
    return alike


def _as_often(radius: float, spokes: int) -> list[tuple[float, int]]:
    """All radii with numbers of spokes of which as many pass by per metre: seen off its hub one looks like another."""
    radii = radius / spokes * SPOKES
    return [(float(r), int(m)) for r, m in zip(radii, SPOKES, strict=True) if RADII[0] <= r <= RADII[-1]]


def _hubs_of(tried: NDArray, alike: NDArray, radius: float, spokes: int) -> NDArray[np.float64]:
    """[2, 3] of those ``tried`` [end, hubs, 3] the ones about which most is ``alike`` [end, hubs, radii, spokes]."""
    best = alike[..., np.abs(RADII - radius).argmin(), spokes - SPOKES[0]].argmax(1)
    return tried[[0, 1], best]


@dataclass(frozen=True)
class _Wheels:
    """A front and a rear wheel."""

    hubs: NDArray[np.float64]
    """[2, 3] [m]."""
    radius: float
    """[m]."""
    spokes: int
    alike: float
    """Share of all that turns as they do."""


def _refined(
    looks: Sequence[Look], ways: NDArray[np.float64], hubs: NDArray[np.float64], radius: float, spokes: int
) -> _Wheels:
    """Hubs [2, 3] and radius nearby about which most is alike, overtones included."""
    overtones = SPOKES % spokes == 0

    def alike(hub: NDArray, radii: NDArray) -> NDArray[np.float64]:
        return _alike(_harmonics(looks, hub)[None], ways, radii)[0][:, overtones].sum(1)

    hubs, both = hubs.copy(), np.zeros(1)
    for step in STEPS:
        for _ in range(2):
            for hub in hubs:
                for axis in np.eye(3):
                    places = hub + step * np.arange(-2, 3)[:, None] * axis
                    hub[:] = places[np.argmax([alike(place, np.array([radius])) for place in places])]
            radii = radius + np.linspace(-NEARBY, NEARBY, 41)
            both = alike(hubs[0], radii) + alike(hubs[1], radii)
            radius = float(radii[both.argmax()])
    return _Wheels(hubs, radius, spokes, float(both.max()))


def _phases(
    looks: Sequence[Look], trajectory: Trajectory, hubs: NDArray[np.float64], radius: float, spokes: int
) -> NDArray[np.float64]:
    """[2] angles [rad] that make the rear wheel look as the front one does."""
    times, m = [look.time for look in looks], int(np.flatnonzero(spokes == SPOKES)[0])
    at_rest = [
        np.exp(1j * spokes / radius * trajectory.driven(times, hub)) @ _harmonics(looks, hub)[..., m] for hub in hubs
    ]
    return np.array([0.0, -np.angle(np.vdot(*at_rest)) / spokes])
