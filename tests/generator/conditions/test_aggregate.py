from dataclasses import replace

import numpy as np
import pytest
from toy_vehicle import SIZE, box_points, drive

from dwgs.scene import InputError, LidarSweep, Scene, Track
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import transform_points
from generator.conditions.points import points_of_track

RED, BLUE = (200, 0, 0), (0, 0, 200)


def recording(scene: Scene, wall: float | None = None) -> tuple[Scene, Track]:
    """A box drives away at 10 m/s; every sweep hits its rear for 40 ms and ends 50 ms before the exposure."""
    trajectory = drive(8.0)
    track = Track("box", "Car", SIZE, trajectory, is_moving=True)
    rear = box_points(SIZE, 6000)
    rear = rear.points[rear.points[:, 0] < -SIZE[0] / 2 + 1e-3]
    rng = np.random.default_rng(0)
    sweeps = []
    for i in range(1, 3):
        end = 0.1 * i - 0.05
        times = end - 0.04 * rng.random(len(rear))
        points = np.stack([transform_points(trajectory.at(t), p[None])[0] for t, p in zip(times, rear, strict=True)])
        if wall is not None:
            obstacle = np.stack([np.full(40_000, wall), rng.uniform(-1, 1, 40_000), rng.uniform(0, 3, 40_000)], 1)
            points, times = np.concatenate([points, obstacle]), np.concatenate([times, np.full(40_000, end)])
        sweeps.append(LidarSweep(points.astype(np.float32), times, np.array([0, 0, 2.0]), end, 10 + i))

    def frame(f):
        silhouette = np.full((120, 160, 3), BLUE, np.uint8)
        pixels, _ = f.camera.project(
            transform_points(trajectory.at(f.camera.time), [[-2, 0.9, 0.75], [-2, -0.9, -0.75]])
        )
        (left, top), (right, bottom) = np.floor(pixels).astype(int)
        silhouette[top : bottom + 1, left : right + 1] = RED
        return replace(f, load_pixels=lambda: silhouette)

    frames = {name: tuple(frame(f) for f in fs) for name, fs in scene.frames.items()}
    return replace(scene, frames=frames, sweeps=tuple(sweeps), tracks=(track,)), track


def test_a_moving_vehicle_is_gathered_without_smear_and_in_its_own_colour(scene: Scene):
    recorded, track = recording(scene)
    vehicle, size = points_of_track(recorded, track)
    np.testing.assert_array_equal(size, SIZE)
    np.testing.assert_allclose(vehicle.points[:, 0], -SIZE[0] / 2, atol=2e-3)
    assert (vehicle.colors == RED).all()
    assert not vehicle.is_complete


def test_the_lowest_band_is_left_out_and_one_point_is_kept_per_voxel(scene: Scene):
    recorded, track = recording(scene)
    vehicle, _ = points_of_track(recorded, track)
    assert vehicle.points[:, 2].min() > -SIZE[2] / 2 + 0.12
    voxels = np.floor(vehicle.points / 0.02)
    assert len(np.unique(voxels, axis=0)) >= len(voxels) - 2  # float32 may move a point across a voxel's face


def test_a_window_uses_fewer_sweeps(scene: Scene):
    recorded, track = recording(scene)
    assert len(points_of_track(recorded, track, 0)[0].points) < len(points_of_track(recorded, track)[0].points)


def test_what_something_nearer_hides_from_the_camera_is_not_coloured(scene: Scene):
    recorded, track = recording(scene, wall=4.0)
    with pytest.raises(InputError, match="at least 100 LiDAR points that a camera saw, track box"):
        points_of_track(recorded, track)


def test_points_labelled_as_ground_are_not_the_vehicle(scene: Scene):
    recorded, track = recording(scene)
    ground = SURFACES.index("ground")
    labelled = [replace(s, labels=np.full(len(s.points), ground, np.uint8)) for s in recorded.sweeps]
    with pytest.raises(InputError, match="has 0"):
        points_of_track(replace(recorded, sweeps=tuple(labelled)), track)


def test_a_recording_without_lidar_says_so(scene: Scene):
    track = Track("box", "Car", SIZE, drive(8.0), is_moving=True)
    with pytest.raises(InputError, match="LiDAR points"):
        points_of_track(scene, track)
