"""What a path trembles is told from what it does, and a vehicle points where it drives."""

import numpy as np
from scipy.spatial.transform import Rotation

from dwgs.distill.config import GENERATED, RECORDED
from dwgs.distill.path import Path, apart, moved
from dwgs.scene.pose import pose, yaw_rotation

COUNT = 150
TIMES = np.arange(COUNT) / 10
NOISE = np.repeat((np.radians(0.5), 0.05), 3)
YAW, ACROSS, UP = 2, 4, 5
BUT_ALONG = np.arange(6) != 3


def drive(yaw, arm):
    """Poses at 8 m/s, heading by ``yaw`` [N], the box centre so far ahead of the axle that does not slide."""
    heading = np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], 1)
    return pose(yaw_rotation(yaw), np.cumsum(0.8 * heading, 0) + arm * heading)


STRAIGHT = drive(np.zeros(COUNT), arm=0.0)
WINDING = drive(0.2 * np.sin(0.8 * TIMES), arm=1.3)


def shaken(poses, seed):
    noise = NOISE * np.random.default_rng(seed).normal(size=(len(poses), 6))
    return poses @ pose(Rotation.from_rotvec(noise[:, :3]).as_matrix(), noise[:, 3:])


def left(truth, times=TIMES, cameras=("front",) * COUNT):
    """[6] root mean square about and along the vehicle's axes, per noise, after its paths have settled."""
    squares = []
    for seed in range(4):
        given = shaken(truth, seed)
        path = Path(times, cameras, given, GENERATED.path)
        settled = moved(given, path.moves(given, np.zeros((COUNT, 6, 6)), np.zeros((COUNT, 6))))
        off = np.einsum("nji,nkj->nki", truth[:, :3, :3], apart(settled, truth).reshape(-1, 2, 3)).reshape(-1, 6)
        squares.append((off / NOISE) ** 2)
    return np.sqrt(np.mean(squares, (0, 1)))


def test_where_nothing_happens_an_axis_keeps_still():
    assert (left(STRAIGHT)[BUT_ALONG] < 0.15).all()


def test_on_a_winding_drive_a_quarter_of_the_noise_is_left():
    assert (left(WINDING) < 0.25).all()


def test_wheels_that_do_not_slide_tell_where_a_vehicle_goes():
    crab = WINDING.copy()
    crab[:, :3, :3] = np.eye(3)
    assert left(WINDING)[ACROSS] < 0.7 * left(crab)[ACROSS]


def test_a_vehicle_that_slides_sideways_is_left_to():
    crab = WINDING.copy()
    crab[:, :3, :3] = np.eye(3)
    assert (left(crab) < 0.4).all()
    assert left(crab)[YAW] < 0.15


def test_frames_of_two_cameras_and_gaps_have_paths_of_their_own():
    poses, times, half = WINDING.copy(), TIMES.copy(), COUNT // 2
    poses[half:, :3, 3] += 50.0
    times[half:] -= 5.0
    two = left(poses, times, ("front",) * half + ("left",) * (COUNT - half))
    times[half:] += 50.0
    gap = left(poses, times)
    assert (two < 0.4).all()
    assert (gap < 0.4).all()


def test_an_axis_that_does_not_tremble_keeps_the_jerk_of_the_recipe():
    bouncing = STRAIGHT.copy()
    bouncing[:, 2, 3] += 0.1 * np.sin(2 * TIMES)
    given = bouncing.copy()
    given[:, 1, 3] += np.random.default_rng(0).normal(0, 0.05, COUNT)
    path = Path(TIMES, ["front"] * COUNT, given, GENERATED.path)
    assert path.is_rough()
    moves = path.moves(given, np.zeros((COUNT, 6, 6)), np.zeros((COUNT, 6)))
    assert np.abs(moves[:, UP]).max() < 0.005
    assert (given[:, 1, 3] + moves[:, ACROSS]).std() < 0.01


def test_annotated_boxes_that_tremble_no_more_than_they_may_be_off_are_not_taken_at_their_word():
    level = shaken(STRAIGHT, seed=0)
    level[:, 2, 3] = 0.0
    path = Path(TIMES, ["front"] * COUNT, level, RECORDED.path)
    assert path.is_rough()
    information, higher = np.broadcast_to(1e5 * np.eye(6), (COUNT, 6, 6)), np.zeros((COUNT, 6))
    higher[:, UP] = 0.02 * np.sin(2 * TIMES)
    moves = path.moves(level, information, -np.einsum("nij,nj->ni", information, higher))
    np.testing.assert_allclose(moves[:, UP], higher[:, UP], atol=2e-3)


def test_what_pictures_are_sure_of_takes_the_path_along():
    given = shaken(STRAIGHT, seed=0)
    path = Path(TIMES, ["front"] * COUNT, given, GENERATED.path)
    information, higher = np.zeros((COUNT, 6, 6)), np.zeros((COUNT, 6))
    information[::10] = 1e10 * np.eye(6)
    higher[:, UP] = 0.03
    moves = path.moves(STRAIGHT, information, -np.einsum("nij,nj->ni", information, higher))
    np.testing.assert_allclose(moves[::10], higher[::10], atol=1e-3)
    np.testing.assert_allclose(moves[:, UP], 0.03, atol=1e-2)
