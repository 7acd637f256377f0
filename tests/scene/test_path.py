"""A driven path is smooth, measured in metres, and straight beyond its ends."""

import numpy as np
import pytest

from dwgs.scene import Trajectory
from dwgs.scene.path import Path
from dwgs.scene.pose import pose, yaw_rotation


def drive(xy: np.ndarray, heading: np.ndarray) -> Trajectory:
    positions = np.column_stack([xy, np.zeros(len(xy))])
    return Trajectory(np.arange(len(xy)) / 10, pose(yaw_rotation(heading), positions))


def test_on_a_circle_length_position_and_heading_are_those_of_the_circle():
    radius = 30.0
    turned = np.linspace(0, 1.5, 200)
    xy = radius * np.stack([np.sin(turned), 1 - np.cos(turned)], 1)
    path = Path.of(drive(xy, turned))
    s = np.linspace(0, path.length, 50)
    assert path.length == pytest.approx(1.5 * radius, abs=KNOT_SLACK)
    position, heading = path.at(s)
    np.testing.assert_allclose(np.hypot(position[:, 0], radius - position[:, 1]), radius, atol=0.01)
    np.testing.assert_allclose(heading, s / radius, atol=0.01)
    beside, _ = path.at(s, left=2.0)
    np.testing.assert_allclose(np.hypot(beside[:, 0], radius - beside[:, 1]), radius - 2, atol=0.02)


KNOT_SLACK = 2.1
"""The path ends at its last knot, at most one spacing before the last position."""


def test_beyond_its_ends_it_goes_on_straight():
    path = Path.of(drive(np.stack([np.linspace(0, 20, 100), np.zeros(100)], 1), np.zeros(100)))
    position, heading = path.at([-7.0, 55.0], left=-1.5)
    np.testing.assert_allclose(position, [[-7, -1.5], [55, -1.5]], atol=1e-9)
    np.testing.assert_allclose(heading, 0, atol=1e-9)
    np.testing.assert_allclose(path.locate([[-7, 3], [12.34, -5], [55, 0]]), [-7, 12.34, 55], atol=1e-9)


def test_standing_still_it_is_the_line_that_the_vehicle_faces():
    rng = np.random.default_rng(0)
    path = Path.of(drive(5 + rng.normal(0, 0.02, (50, 2)), np.full(50, np.pi / 2)))
    assert path.length == 0
    position, heading = path.at(np.array([0.0, 10.0]), left=3.0)
    np.testing.assert_allclose(heading, np.pi / 2)
    np.testing.assert_allclose(position[1] - position[0], (0, 10), atol=1e-9)
    np.testing.assert_allclose(position[0], (2, 5), atol=0.1)


def test_jitter_of_a_creeping_car_does_not_turn_it():
    rng = np.random.default_rng(1)
    x = np.concatenate([np.zeros(100), np.linspace(0, 15, 50), np.full(100, 15.0)])
    xy = np.stack([x, np.zeros_like(x)], 1) + rng.normal(0, 0.01, (len(x), 2))
    path = Path.of(drive(xy, rng.normal(0, 0.002, len(x))))
    _, heading = path.at(np.linspace(-5, 30, 200))
    assert abs(np.degrees(heading)).max() < 1


def test_a_turn_past_half_a_circle_has_no_jump():
    turned = np.linspace(2.5, 4.5, 150)
    path = Path.of(drive(20 * np.stack([np.sin(turned), -np.cos(turned)], 1), turned))
    _, heading = path.at(np.linspace(0, path.length, 300))
    assert abs(np.diff(heading)).max() < 0.02
