"""Wheels are found by their turning in step with the way."""

import numpy as np
import pytest
from rolling_car import FRAMES, HUBS, RADIUS, SIZE, SPOKES, drive, shots_of

from dwgs.distill.wheels import find_wheels


@pytest.fixture(scope="module")
def found():
    trajectory = drive()
    return find_wheels(shots_of(trajectory), SIZE, trajectory, seed=0)


def test_wheels_that_roll_are_found(found):
    assert found is not None
    assert found.spokes == SPOKES
    assert found.radius == pytest.approx(RADIUS, rel=0.01)
    np.testing.assert_allclose(found.hubs[:, [0, 2]], HUBS[:, [0, 2]], atol=0.03)
    assert not found.is_other_side_seen
    assert len(found.looks) == FRAMES


def test_both_wheels_are_one_wheel_at_all_times(found):
    part = 2 * np.pi / SPOKES
    for time in (0.0, 0.4, 1.1):
        front, rear = found.angles(time)
        assert (front - rear + part / 2) % part - part / 2 == pytest.approx(0, abs=0.06)


def test_wheels_that_slide_are_not_found():
    trajectory = drive()
    assert find_wheels(shots_of(trajectory, np.inf), SIZE, trajectory, seed=0) is None


def test_wheels_that_turn_too_fast_for_any_car_are_not_found():
    trajectory = drive()
    assert find_wheels(shots_of(trajectory, 0.23), SIZE, trajectory, seed=0) is None


def test_wheels_that_stand_are_not_found():
    trajectory = drive(np.full(FRAMES - 1, 1e-9))
    assert find_wheels(shots_of(trajectory), SIZE, trajectory, seed=0) is None


def test_a_few_frames_do_not_tell():
    trajectory = drive()
    assert find_wheels(shots_of(trajectory)[:5], SIZE, trajectory, seed=0) is None
