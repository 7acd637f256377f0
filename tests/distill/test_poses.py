"""Poses are settled between what the images ask for and what a vehicle can drive."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dwgs.distill.config import GENERATED, RECORDED
from dwgs.distill.poses import MOST, BoxPoses
from dwgs.scene import Trajectory
from dwgs.scene.pose import pose, yaw_rotation


def sights_along(world_from_vehicle, times):
    camera = SimpleNamespace(world_from_camera=np.eye(4))
    frames = [SimpleNamespace(camera=SimpleNamespace(time=t), camera_name="front") for t in times]
    return [
        SimpleNamespace(world_from_vehicle=p, camera=camera, frame=frame)
        for p, frame in zip(world_from_vehicle, frames, strict=True)
    ]


def curve(count):
    """A smooth drive, and its times."""
    t = np.arange(count) / 10
    return pose(yaw_rotation(0.1 * t), np.stack([8 * t, 0.3 * t**2, 0 * t], 1)), t


def off(poses, smooth):
    """Root mean square of angles [rad] and places [m]."""
    turned = poses[:, :3, :3] @ np.swapaxes(smooth[:, :3, :3], 1, 2)
    angles = Rotation.from_matrix(turned).as_rotvec()
    return np.sqrt((angles**2).mean()), np.sqrt(((poses - smooth)[:, :3, 3] ** 2).mean())


@pytest.fixture
def trembling():
    smooth, times = curve(80)
    random = np.random.default_rng(1)
    noise = pose(
        Rotation.from_rotvec(random.normal(0, np.radians(0.5), (80, 3))).as_matrix(), random.normal(0, 0.05, (80, 3))
    )
    return smooth, smooth @ noise, times


def test_a_drive_is_smooth_and_noise_on_it_is_measured(trembling):
    smooth, noisy, times = trembling
    assert not BoxPoses(sights_along(smooth, times), GENERATED).is_rough()
    poses = BoxPoses(sights_along(noisy, times), GENERATED)
    assert poses.is_rough()


def test_before_anything_is_seen_poses_settle_on_a_smooth_path(trembling):
    smooth, noisy, times = trembling
    poses = BoxPoses(sights_along(noisy, times), GENERATED)
    poses.settle()
    settled = np.array([noisy[i] @ poses.old_from_new(i) for i in range(80)])
    for before, after in zip(off(noisy, smooth), off(settled, smooth), strict=True):
        assert after < 0.5 * before


def test_the_refined_trajectory_passes_where_the_poses_settled(trembling):
    _, noisy, times = trembling
    poses = BoxPoses(sights_along(noisy, times), GENERATED)
    poses.settle()
    recorded = Trajectory(times[::2], noisy[::2])
    refined = poses.refined(recorded)
    np.testing.assert_allclose(refined.times, times)
    np.testing.assert_allclose(
        refined.at(times[::2]), [noisy[i] @ poses.old_from_new(i) for i in range(0, 80, 2)], atol=1e-9
    )


def test_a_smooth_path_settles_where_it_is():
    smooth, times = curve(40)
    poses = BoxPoses(sights_along(smooth, times), GENERATED)
    poses.settle()
    assert np.abs(poses.corrections()).max() < 2e-3


def test_no_correction_leaves_the_room_that_the_layers_have():
    smooth, times = curve(40)
    smooth[::2, :3, 3] += 3.0
    poses = BoxPoses(sights_along(smooth, times), GENERATED)
    poses.settle()
    assert (np.abs(poses.corrections()) <= MOST + 1e-9).all()


def test_a_sharp_manoeuvre_is_no_noise():
    _, times = curve(24)
    phase = np.linspace(0, np.pi, 24)
    swerve, drift = 1.75 * (1 - np.cos(phase)), 1.75 * np.sin(phase) * np.pi / times[-1]  # a lane in two seconds
    path = pose(yaw_rotation(np.arctan(drift / 8)), np.stack([8 * times, swerve, 0 * times], 1))
    poses = BoxPoses(sights_along(path, times), GENERATED)
    assert not poses.is_rough()
    poses.settle()
    assert np.abs(poses.corrections()).max() < 5e-3


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_a_few_frames_have_no_jerk(count):
    smooth, times = curve(count)
    poses = BoxPoses(sights_along(smooth, times), RECORDED)
    assert not poses.is_rough()
    poses.settle()
    np.testing.assert_allclose(poses.corrections(), 0, atol=1e-12)


def test_frames_of_two_cameras_and_gaps_are_not_compared():
    smooth, times = curve(8)
    smooth[4:, :3, 3] += 5.0
    times[4:] += 3.0
    assert not BoxPoses(sights_along(smooth, times), GENERATED).is_rough()
