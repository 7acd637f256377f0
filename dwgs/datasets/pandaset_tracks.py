"""Boxes of PandaSet, frame by frame, joined into tracks."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.lidar import LidarSweep
from dwgs.scene.pose import inverse, pose, transform_points, yaw_rotation
from dwgs.scene.track import MOVING_DISTANCE, Track
from dwgs.scene.trajectory import Trajectory

_VEHICLES = {
    "Car", "Pickup Truck", "Medium-sized Truck", "Semi-truck", "Towed Object", "Bus", "Train", "Trolley",
    "Tram / Subway", "Emergency Vehicle", "Other Vehicle - Construction Vehicle", "Other Vehicle - Uncommon",
}  # fmt: skip
"""Rigid and on wheels. Riders move on theirs: motorcycles, bicycles, scooters and pedicabs are not rigid."""

_SPINNING = (-1, 0)
"""Sensors of a box that is good for the spinning LiDAR: of both (it stands), or its own."""

_FEWEST_POINTS = 5
"""Returns [1] inside a box that date it."""


@dataclass(frozen=True)
class Cuboids:
    """The boxes of one frame."""

    ids: list[str]
    """[B]."""
    siblings: list[str]
    """[B] the same object as the other LiDAR saw it, or ``-``."""
    categories: list[str]
    """[B]."""
    is_spinning: NDArray[np.bool_]
    """[B] whether the box fits what the spinning LiDAR saw."""
    is_stationary: NDArray[np.bool_]
    """[B] as annotated."""
    sizes: NDArray[np.float64]
    """[B, 3] (length, width, height) [m]."""
    world_from_box: NDArray[np.float64]
    """[B, 4, 4], x forward."""

    @staticmethod
    def from_table(table: dict[str, NDArray], file: Path) -> "Cuboids":
        """Boxes of a table whose ``dimensions.x`` is the width, whose yaw turns +y to the front."""
        try:
            centres = np.stack([table[f"position.{axis}"] for axis in "xyz"], 1).astype(np.float64)
            width, length, height = (table[f"dimensions.{axis}"].astype(np.float64) for axis in "xyz")
            yaw = table["yaw"].astype(np.float64) + np.pi / 2
            boxes = Cuboids(
                ids=[str(id) for id in table["uuid"]],
                siblings=[str(id) for id in table.get("cuboids.sibling_id", np.full(len(yaw), "-"))],
                categories=[str(label) for label in table["label"]],
                is_spinning=np.isin(table.get("cuboids.sensor_id", np.full(len(yaw), -1)), _SPINNING),
                is_stationary=table["stationary"].astype(bool),
                sizes=np.stack([length, width, height], 1),
                world_from_box=pose(yaw_rotation(yaw), centres),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"'{file}' is not a table of PandaSet cuboids: {error!r}") from None
        if not np.isfinite(boxes.world_from_box).all() or not (boxes.sizes > 0).all():
            raise InputError(f"boxes have finite poses and positive sizes, some in '{file}' have not")
        return boxes


@dataclass(frozen=True)
class _Sighting:
    frame: int
    id: str
    is_spinning: bool
    is_stationary: bool
    category: str
    size: NDArray[np.float64]
    world_from_box: NDArray[np.float64]
    lead: float
    """How long before the end of the sweep [s] its points were hit; NaN where there are too few."""


def read_tracks(
    boxes: Mapping[int, Cuboids], sweeps: Iterable[LidarSweep], stamps: NDArray[np.float64]
) -> tuple[Track, ...]:
    """Tracks of the boxes of each frame; ``stamps`` [s] are the ends of the sweeps by frame number.

    A moving object that both LiDARs saw has a box from each, under two ids: the track keeps the spinning
    LiDAR's. A box is where its points were when they were hit, up to 0.1 s before the stamp: its time.
    Images of its frame are taken up to half a period off; both ends reach as far, at constant velocity.
    """
    sweep_of = {sweep.frame_index: sweep for sweep in sweeps}
    seen: dict[str, list[_Sighting]] = defaultdict(list)
    twin: dict[str, str] = {}
    for frame in sorted(boxes):
        box = boxes[frame]
        leads = stamps[frame] - _times_hit(box, sweep_of.get(frame))
        fields = (
            box.ids,
            box.is_spinning,
            box.is_stationary,
            box.categories,
            box.sizes,
            box.world_from_box,
            leads,
        )
        for sighting in map(partial(_Sighting, frame), *fields):
            seen[sighting.id].append(sighting)
        for id, sibling in zip(box.ids, box.siblings, strict=True):
            if sibling not in ("-", id):  # a box can be its own sibling in the recording
                twin.setdefault(id, sibling)
                twin.setdefault(sibling, id)
    leads = np.array([s.lead for many in seen.values() for s in many])
    usual = float(np.median(leads[np.isfinite(leads)])) if np.isfinite(leads).any() else 0.0
    return tuple(_track(one, other, usual, stamps) for one, other in _pairs(seen, twin))


def _pairs(seen: dict[str, list[_Sighting]], twin: dict[str, str]) -> Iterator[tuple[list[_Sighting], list[_Sighting]]]:
    """Each object once, as the spinning LiDAR saw it and as the other did."""
    done: set[str] = set()
    for id in seen:
        if id not in done:
            one, other = seen[id], seen.get(twin.get(id, ""), [])
            done.update(s.id for s in other)
            swap = sum(s.is_spinning for s in other) > sum(s.is_spinning for s in one)
            yield (other, one) if swap else (one, other)


def _times_hit(boxes: Cuboids, sweep: LidarSweep | None) -> NDArray[np.float64]:
    """Median time [B] [s] of the points inside each box, NaN where there are too few."""
    times = np.full(len(boxes.ids), np.nan)
    if sweep is None:
        return times
    order = np.argsort(sweep.points[:, 0])
    points, hit = sweep.points[order], sweep.times[order]
    reach = np.linalg.norm(boxes.sizes, axis=1) / 2
    centre = boxes.world_from_box[:, 0, 3]
    first, last = np.searchsorted(points[:, 0], [centre - reach, centre + reach])
    for i, box_from_world in enumerate(inverse(boxes.world_from_box)):
        near = slice(first[i], last[i])
        local = transform_points(box_from_world, points[near])
        inside = (abs(local) <= boxes.sizes[i] / 2).all(1)
        if inside.sum() >= _FEWEST_POINTS:
            times[i] = np.median(hit[near][inside])
    return times


def _track(seen: list[_Sighting], twins: list[_Sighting], usual: float, stamps: NDArray[np.float64]) -> Track:
    frames = np.array([s.frame for s in seen])
    leads = np.array([s.lead for s in seen])
    dated = np.isfinite(leads)  # a frame without a sweep takes after its neighbours
    leads = np.interp(frames, frames[dated], leads[dated]) if dated.any() else np.full(len(frames), usual)
    times = stamps[frames] - leads
    later = np.append(True, times[1:] > np.maximum.accumulate(times)[:-1])
    world_from_box = np.stack([s.world_from_box for s in seen])
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.1
    strays = np.ptp(world_from_box[:, :3, 3], axis=0).max()
    return Track(
        id=seen[0].id,
        category=seen[0].category,
        size=np.median([s.size for s in seen], axis=0),
        trajectory=_prolonged(times[later], world_from_box[later], period / 2),
        is_moving=bool(strays > MOVING_DISTANCE) or not all(s.is_stationary for s in [*seen, *twins]),
        is_vehicle=seen[0].category in _VEHICLES,
    )


def _prolonged(times: NDArray, world_from_box: NDArray, by: float) -> Trajectory:
    """The motion, gone on with for ``by`` seconds on either side."""
    before, after = world_from_box[0].copy(), world_from_box[-1].copy()
    if len(times) > 1:
        steps = np.diff(world_from_box[:, :3, 3], axis=0) / np.diff(times)[:, None]
        before[:3, 3] -= by * steps[0]
        after[:3, 3] += by * steps[-1]
    return Trajectory(
        np.concatenate([[times[0] - by], times, [times[-1] + by]]),
        np.concatenate([before[None], world_from_box, after[None]]),
    )
