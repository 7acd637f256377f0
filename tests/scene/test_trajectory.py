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


def drive(xs, heading=0.0):
    """Along the axis that it heads for, to these places one after the other."""
    poses = pose(np.broadcast_to(yaw_rotation(heading), (len(xs), 3, 3)), np.outer(xs, [1.0, 0, 0]))
    return Trajectory(np.arange(float(len(xs))), poses)


def test_what_is_driven_grows_ahead_rests_when_it_stands_and_is_taken_back_in_reverse():
    np.testing.assert_allclose(drive([0, 3, 3, 1]).driven([-1, 0.5, 1, 2, 3, 9]), [0, 1.5, 3, 3, 1, 1])


def test_a_vehicle_of_one_pose_never_drives():
    assert drive([5]).driven(0.3) == 0


def test_slipping_sideways_is_not_driving():
    np.testing.assert_allclose(drive([0, 3], heading=np.pi / 2).driven([0, 1]), [0, 0], atol=1e-12)


def test_in_a_left_turn_what_is_on_the_right_comes_farther():
    angles = np.linspace(0, 1, 50)
    circle = 10 * np.stack([np.sin(angles), 1 - np.cos(angles), 0 * angles], -1)
    turn = Trajectory(angles, pose(yaw_rotation(angles), circle))
    ways = [turn.driven(1.0, (0.0, left, 0.0)) for left in (0.8, 0.0, -0.8)]
    np.testing.assert_allclose(ways, [9.2, 10, 10.8], rtol=1e-3)
