"""Clips that teach: a recorded vehicle, its LiDAR points, and the frames in which it was seen."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dwgs.scene import InputError, Insertion, Scene, Track
from generator.conditions import ConditionFrame, Conditions, make_conditions
from generator.conditions.aggregate import WINDOW
from generator.conditions.conditions import PointStyle
from generator.conditions.points import points_of_track
from generator.conditions.whole_frame import StreetPoints, whole_frame
from generator.training.config import ClipConfig

SEEN = 0.5
"""A clip teaches where the vehicle's points show in at least this share of its frames."""


@dataclass(frozen=True)
class TrainingClip:
    """Frames that show one recorded vehicle, with the conditions under which they are to be made again."""

    scene: str
    """Name of the drive."""
    track: str
    """Id of the vehicle."""
    stride: int
    """From one frame to the next."""
    frames: tuple[ConditionFrame, ...]

    @property
    def name(self) -> str:
        """Unique among the clips of drives with different names."""
        return f"{self.scene}/{self.track}/{self.frames[0].frame.index}x{self.stride}"


def clips_of(scene: Scene, config: ClipConfig) -> Iterator[TrainingClip]:
    """Clips of every vehicle that the main camera and the LiDAR saw, track by track, in order of time."""
    street = StreetPoints(scene)
    for track in scene.tracks:
        conditions = _conditions(scene, track, config.points) if track.is_vehicle else None
        if conditions is None:
            continue
        is_seen = [frame.load_point_mask().any() for frame in conditions.frames[scene.main_camera]]
        if config.whole_frame:
            conditions = whole_frame(conditions, street)
        frames = conditions.frames[scene.main_camera]
        for stride in config.strides:
            reach = (config.frames - 1) * stride + 1
            for first in range(0, len(frames) - reach + 1, config.hop * stride):
                clip = slice(first, first + reach, stride)
                if np.mean(is_seen[clip]) >= SEEN:
                    yield TrainingClip(scene.name, track.id, stride, frames[clip])


def _conditions(scene: Scene, track: Track, points: PointStyle) -> Conditions | None:
    """Conditions of the longest run of the main camera's frames that the track covers; None without points."""
    recorded = scene.frames[scene.main_camera]
    covered = track.trajectory.covers(np.array([frame.camera.time for frame in recorded]))
    inside = np.flatnonzero(covered)
    if len(inside) == 0:
        return None
    frames = recorded[inside[0] : inside[-1] + 1]
    try:
        vehicle, size = points_of_track(scene, track, WINDOW)
        insertion = Insertion(vehicle, size, track.trajectory, track.category)
        seen = replace(scene, frames={scene.main_camera: frames})
        return make_conditions(seen, insertion, points=points)
    except InputError:  # too few points, or never in view: such a vehicle teaches nothing
        return None
