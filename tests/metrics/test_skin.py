"""Colours on a vehicle's surface."""

import math

import numpy as np
import pytest

from dwgs.metrics.skin import flicker, point_error, skin_colors
from dwgs.scene import Camera, Insertion, Trajectory, VehiclePoints
from dwgs.scene.pose import pose, transform_points

SIZE = np.array([4.0, 2.0, 1.5])
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
RED, BLUE = (200, 30, 30), (30, 30, 200)


def camera(t=0.0):
    return Camera(np.array([[200.0, 0, 100], [0, 200, 60], [0, 0, 1]]), 200, 120, pose(FORWARD, [0, 0, 0]), t)


def two_sided_insertion():
    """A red rear that faces the camera, and a blue front that does not."""
    rng = np.random.default_rng(0)
    y, z = rng.uniform(-0.5, 0.5, (2, 6000)) * SIZE[1:, None]
    x = np.repeat([-SIZE[0] / 2, SIZE[0] / 2], 3000)
    normals = np.where(x[:, None] < 0, [-1.0, 0, 0], [1.0, 0, 0])
    colors = np.where(x[:, None] < 0, RED, BLUE).astype(np.uint8)
    vehicle = VehiclePoints(np.column_stack([x, y, z]).astype(np.float32), colors, normals.astype(np.float32), True)
    times = np.arange(5.0)
    positions = np.column_stack([10 + times, 0 * times, 0 * times])
    return Insertion(vehicle, SIZE, Trajectory(times, np.stack([pose(np.eye(3), p) for p in positions])))


def plain(_):
    return np.full((120, 200, 3), 99, np.uint8)


@pytest.fixture
def insertion():
    return two_sided_insertion()


def test_only_the_side_that_faces_the_camera_is_seen(insertion):
    colors, own = skin_colors(insertion, [camera()], plain)
    seen = np.isfinite(colors[0, :, 0])
    assert seen.any()
    assert (own[seen] == RED).all()
    assert not seen[(own == BLUE).all(1)].any()


def test_a_scan_without_normals_hides_its_far_side_by_depth(insertion):
    scan = VehiclePoints(insertion.vehicle.points, insertion.vehicle.colors)
    scanned = Insertion(scan, SIZE, insertion.trajectory)
    colors, own = skin_colors(scanned, [camera()], plain)
    seen = np.isfinite(colors[0, :, 0])
    assert (own[seen] == RED).mean() > 0.99


def test_a_point_shows_the_colour_of_the_pixel_where_it_falls(insertion):
    x, y = np.meshgrid(np.arange(200), np.arange(120))
    ramp = np.stack([x, y, 0 * x], -1).astype(np.uint8)
    colors, _ = skin_colors(insertion, [camera(1.0)], lambda t: ramp)
    watched = np.unique(np.linspace(0, 5999, 4000).round().astype(int))
    world = transform_points(insertion.trajectory.at(1.0), insertion.vehicle.points[watched])
    uv, _ = camera().project(world)
    seen = np.isfinite(colors[0, :, 0])
    np.testing.assert_allclose(colors[0, seen, :2], uv[seen] - 0.5, atol=1e-3)


def test_a_vehicle_outside_the_image_says_nothing(insertion):
    away = Insertion(insertion.vehicle, SIZE, insertion.trajectory.moved(pose(np.eye(3), [-40, 0, 0])))
    colors, own = skin_colors(away, [camera(t) for t in range(3)], lambda t: pytest.fail("nothing to be looked at"))
    assert math.isnan(point_error(colors, own))
    assert math.isnan(flicker(colors))


def random_colors(frames=4, points=60):
    rng = np.random.default_rng(0)
    own = rng.integers(0, 256, (points, 3)).astype(np.float32)
    return np.repeat(own[None], frames, 0), own


def test_true_colours_in_any_light_have_no_point_error():
    shown, own = random_colors()
    assert point_error(0.4 * shown + [10, 20, 30], own) == pytest.approx(0, abs=1e-3)


def test_a_vehicle_of_one_colour_has_the_greatest_point_error():
    shown, own = random_colors()
    spread = np.sqrt(own.var(0).mean())
    assert point_error(np.full_like(shown, 99), own) == pytest.approx(spread, rel=1e-4)
    shuffled = np.random.default_rng(1).permutation(shown, axis=1)
    assert 0.9 * spread < point_error(shuffled, own) <= spread


def test_hidden_points_do_not_count():
    shown, own = random_colors()
    shown[:, :20] = np.nan
    assert point_error(shown, own) == pytest.approx(0, abs=1e-3)
    assert flicker(shown) == 0


def test_steady_change_is_no_flicker_and_blinking_is():
    still = np.full((7, 50, 3), 100.0)
    steady = still + np.arange(7)[:, None, None] * 5
    blinking = still + np.where(np.arange(7) % 2, 3, -3)[:, None, None]
    assert flicker(still) == 0
    assert flicker(steady) == pytest.approx(0)
    assert flicker(blinking) == pytest.approx(6)


def test_flicker_grows_with_noise():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 1, (9, 400, 3))
    values = [flicker(100 + sigma * noise) for sigma in (1, 2, 4)]
    assert values == pytest.approx([values[0], 2 * values[0], 4 * values[0]])
    assert values[0] == pytest.approx(np.sqrt(1.5) * np.sqrt(2 / np.pi), rel=0.05)  # mean of |c - (a + b) / 2|
