from dataclasses import replace

import numpy as np
import pytest

from dwgs.scene import Camera, Frame, LidarSweep, Scene, Track, Trajectory
from dwgs.scene.lidar import SURFACES
from dwgs.scene.moving import moving_tracks, static_points
from dwgs.scene.pose import pose, transform_points

SIZE = np.array([4.0, 1.8, 1.5])


@pytest.fixture
def drive() -> Scene:
    """A wall on the left, and a car that drives past it at 20 m/s while the only sweep is taken."""
    times = np.linspace(0, 1, 11)
    way = Trajectory(times, np.stack([pose(np.eye(3), [10 + 20 * t, 0, 0.75]) for t in times]))
    rng = np.random.default_rng(0)
    wall = np.stack([rng.uniform(5, 40, 500), np.full(500, 6.0), rng.uniform(0, 3, 500)], 1).astype(np.float32)
    sweep = LidarSweep(wall, rng.uniform(0.4, 0.5, 500), np.zeros(3), 0.5, 0)
    camera = Camera(np.eye(3), 16, 16, np.eye(4), 0.5)
    frame = Frame(0, "front", camera, lambda: np.zeros((16, 16, 3), np.uint8))
    return Scene("wall", {"front": (frame,)}, way, (sweep,), (Track("car", "Car", SIZE, way, True),))


def test_points_on_a_moving_car_are_dropped_each_at_its_own_time(drive):
    track, sweep = drive.tracks[0], drive.sweeps[0]
    rng = np.random.default_rng(1)
    times = rng.uniform(0.4, 0.5, 200)
    inside = rng.uniform(-0.5, 0.5, (200, 3)) * SIZE
    on_car = np.concatenate(
        [transform_points(track.trajectory.at(t), p[None]) for t, p in zip(times, inside, strict=True)]
    )
    points = np.concatenate([sweep.points, on_car.astype(np.float32)])
    both = replace(sweep, points=points, times=np.concatenate([sweep.times, times]))
    np.testing.assert_array_equal(static_points(drive, both), sweep.points)


def test_people_noise_and_nan_are_not_the_street(drive):
    sweep = drive.sweeps[0]
    labels = np.zeros(len(sweep.points), np.uint8)
    labels[:10], labels[10:20] = SURFACES.index("person"), SURFACES.index("noise")
    points = sweep.points.copy()
    points[20:30] = np.nan
    kept = static_points(drive, replace(sweep, points=points, labels=labels))
    np.testing.assert_array_equal(kept, sweep.points[30:])


def test_what_stands_or_is_not_recorded_yet_does_not_move(drive):
    parked = replace(drive.tracks[0], is_moving=False)
    assert moving_tracks(drive, 0.5) == [drive.tracks[0]]
    assert moving_tracks(drive, 1.2) == []
    assert moving_tracks(replace(drive, tracks=(parked,)), 0.5) == []
