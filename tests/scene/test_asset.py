from dataclasses import replace

import numpy as np
import pytest

from dwgs.scene import Casting, Gaussians, Shading, Trajectory, VehicleAsset, Wheel
from dwgs.scene.pose import pitch_rotation, pose, rotation_from_quat, transform_points, yaw_rotation

SIZE = np.array([4.0, 1.8, 1.5])
SUN = np.array([0.48, -0.36, 0.8])


def cast(points, world_from_vehicle):
    """[N, 2] where the sun casts points of a vehicle that stands level on the ground, in the world."""
    places = transform_points(world_from_vehicle, points)
    ground = world_from_vehicle[2, 3] - SIZE[2] / 2
    return (places - (places[:, 2:] - ground) / SUN[2] * SUN)[:, :2]


@pytest.fixture
def points():
    return np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3)) * SIZE


def asset_of(points, at_rest):
    shadow = np.column_stack([cast(points, at_rest), np.zeros(len(points))])
    means = (shadow - at_rest[:3, 3]) @ at_rest[:3, :3]
    n = len(points)
    cloud = Gaussians(
        means.astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full((n, 3), 0.1, np.float32),
        np.full(n, 0.5, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    heights = (points[:, 2] + SIZE[2] / 2).astype(np.float32)
    return VehicleAsset(Gaussians.empty(), cloud, SIZE, casting=Casting(SUN, at_rest[:3, :3].T @ SUN, heights))


@pytest.mark.parametrize("turn", [0.0, 0.2, -1.5, 3.0])
def test_a_vehicle_that_turns_has_its_shadow_where_the_sun_casts_it(points, turn):
    at_rest = pose(yaw_rotation(0.7), np.array([3.0, 1.0, 0.75]))
    asset = asset_of(points, at_rest)
    turned = pose(yaw_rotation(0.7 + turn), np.array([9.0, -2.0, 0.75]))
    lies = transform_points(turned, asset.shadow_at(turned).means)[:, :2]
    np.testing.assert_allclose(lies, cast(points, turned), atol=1e-5)


def painted(points):
    """A body whose red grows by 1 per slope along x, and whose green falls by 2 along y; frames showed up to 0.3."""
    asset = asset_of(points, np.eye(4))
    by_slope = np.zeros((len(points), 2, 3), np.float32)
    by_slope[:, 0, 0], by_slope[:, 1, 1] = 1, -2
    return replace(asset, body=asset.shadow, shading=Shading(by_slope, np.array([[-0.3, -0.3], [0.3, 0.3]])))


def test_a_body_is_lit_by_the_sun_as_it_turns(points):
    asset, turned = painted(points), pose(yaw_rotation(0.1), np.zeros(3))
    slope = asset.casting.slope_at(turned)
    change = asset.body_at(turned).sh[:, 0] - asset.body.sh[:, 0]
    np.testing.assert_allclose(change, np.tile([slope[0], -2 * slope[1], 0], (len(points), 1)), atol=1e-6)
    np.testing.assert_array_equal(asset.body_at(np.eye(4)).sh, asset.body.sh)


def test_beyond_what_frames_showed_a_body_stays_lit_as_it_was_there(points):
    asset = painted(points)
    change = asset.body_at(pose(yaw_rotation(np.pi), np.zeros(3))).sh[:, 0] - asset.body.sh[:, 0]
    assert np.abs(change[:, 0]).max() <= 0.3 + 1e-6
    assert np.abs(change[:, 1]).max() <= 0.6 + 1e-6


def test_a_body_whose_colours_stay_is_the_very_same(points):
    asset = replace(painted(points), shading=None)
    assert asset.body_at(pose(yaw_rotation(1.0), np.zeros(3))) is asset.body


def test_a_shadow_that_nothing_is_known_of_turns_with_the_vehicle(points):
    at_rest = np.eye(4)
    asset = VehicleAsset(Gaussians.empty(), asset_of(points, at_rest).shadow, SIZE)
    assert asset.shadow_at(pose(yaw_rotation(1.0), np.zeros(3))) is asset.shadow


HUB, RADIUS = np.array([1.3, -0.8, -0.4]), 0.35


@pytest.fixture
def on_wheels(points):
    cloud = asset_of(points, np.eye(4)).shadow
    return VehicleAsset(cloud, Gaussians.empty(), SIZE, wheels=(Wheel(HUB, RADIUS, 15), Wheel(HUB, RADIUS, 20)))


def ahead(*xs):
    return Trajectory(np.arange(float(len(xs))), pose(np.tile(np.eye(3), (len(xs), 1, 1)), np.outer(xs, [1.0, 0, 0])))


def test_a_wheel_turns_by_the_way_over_its_radius(on_wheels):
    still, wheel, _ = on_wheels.parts_at(ahead(0.0, 2.0), 0.5)
    rotation, rest = pitch_rotation(1.0 / RADIUS), on_wheels.body[15:30]
    np.testing.assert_allclose(wheel.means - HUB, (rest.means - HUB) @ rotation.T, atol=1e-6)
    np.testing.assert_allclose(rotation_from_quat(wheel.quats), rotation @ rotation_from_quat(rest.quats), atol=1e-6)
    np.testing.assert_array_equal(still.means, on_wheels.body.means[:15])


def test_what_touches_the_ground_stays_there_while_a_wheel_rolls():
    foot = asset_of(np.zeros((1, 3)), np.eye(4)).shadow
    foot.means[:] = HUB - [0, 0, RADIUS]
    asset = VehicleAsset(foot, Gaussians.empty(), SIZE, wheels=(Wheel(HUB, RADIUS, 1),))
    step, drive = 1e-3, ahead(0.0, 1.0)
    _, wheel = asset.parts_at(drive, step)
    place = transform_points(drive.at(step), wheel.means)
    np.testing.assert_allclose(place - foot.means, 0, atol=2e-6)


def test_wheels_stand_with_the_vehicle_and_turn_back_with_it(on_wheels):
    drive = ahead(0.0, 1.0, 1.0, 0.0)
    begin, moved, stood, back = (on_wheels.parts_at(drive, t)[1].means for t in (0.0, 1.0, 2.0, 3.0))
    np.testing.assert_array_equal(moved, stood)
    np.testing.assert_allclose(back, begin, atol=1e-6)
    assert np.abs(moved - begin).max() > 0.1


def test_a_body_without_wheels_is_one_cloud_the_very_same_at_all_times(points):
    asset = VehicleAsset(asset_of(points, np.eye(4)).shadow, Gaussians.empty(), SIZE)
    (body,) = asset.parts_at(ahead(0.0, 1.0), 0.3)
    assert body is asset.body


def test_wheels_are_lit_as_the_rest_of_the_body_is(on_wheels):
    count = len(on_wheels.body)
    by_slope = np.random.default_rng(1).normal(size=(count, 2, 3)).astype(np.float32)
    shading = Shading(by_slope, np.array([[-9.0, -9.0], [9.0, 9.0]]))
    casting = Casting(SUN, np.array([0.0, 0.6, 0.8]), np.zeros(0, np.float32))
    lit = replace(on_wheels, casting=casting, shading=shading)
    drive = ahead(0.0, 1.0)
    parts = Gaussians.concatenate(lit.parts_at(drive, 0.5))
    np.testing.assert_array_equal(parts.sh, lit.body_at(drive.at(0.5)).sh)
    assert np.abs(parts.sh - on_wheels.body.sh).max() > 0.1
