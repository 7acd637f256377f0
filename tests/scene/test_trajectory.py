"""Where a vehicle is, and when."""

import numpy as np
import pytest

from dwgs.scene import InputError, Trajectory
from dwgs.scene.pose import pose, yaw_rotation


@pytest.fixture
def turn():
    """Two metres forward in two seconds, turning left by one radian."""
    return Trajectory(
        np.array([1.0, 3.0]), pose(yaw_rotation(np.array([0.0, 1.0])), np.array([[0, 0, 0], [2.0, 0, 0]]))
    )


def test_it_passes_half_way_at_half_time(turn):
    expected = pose(yaw_rotation(0.5), [1, 0, 0])
    np.testing.assert_allclose(turn.at(2.0), expected, atol=1e-12)


def test_it_stands_still_beyond_its_ends(turn):
    np.testing.assert_array_equal(turn.at([0.0, 9.0]), turn.world_from_vehicle)


def test_it_says_what_it_covers(turn):
    assert turn.covers([0.9, 1.0, 3.0, 3.1]).tolist() == [False, True, True, False]
    with pytest.raises(InputError, match=r"covers 1\.00-3\.00 s but frame 2 of the clip is at 3\.40 s"):
        turn.require([1.0, 2.0, 3.4])


def test_a_single_pose_is_a_parked_vehicle():
    parked = Trajectory(np.zeros(1), np.eye(4)[None])
    np.testing.assert_array_equal(parked.at([0.0, 5.0]), np.stack([np.eye(4)] * 2))
    assert parked.length == 0


@pytest.mark.parametrize("times", [[1.0, 1.0], [2.0, 1.0], [0.0, np.nan]])
def test_times_must_increase(times):
    with pytest.raises(InputError, match="increasing"):
        Trajectory(np.array(times), np.stack([np.eye(4)] * 2))


def test_poses_must_be_rigid():
    with pytest.raises(InputError, match="rotation"):
        Trajectory(np.zeros(1), 2 * np.eye(4)[None])
