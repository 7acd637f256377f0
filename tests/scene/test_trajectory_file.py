"""Trajectories in files of people and simulators."""

import json

import numpy as np
import pytest

from dwgs.scene import InputError, Trajectory
from dwgs.scene.pose import pose, rotation_from_quat, yaw_rotation
from dwgs.scene.trajectory_file import read_trajectory, write_trajectory

SIZE = (4.5, 1.8, 1.5)


def written(tmp_path, content, name="a.json"):
    (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return tmp_path / name


def test_what_is_written_comes_back_bit_by_bit(tmp_path):
    rng = np.random.default_rng(0)
    rotation = rotation_from_quat(rng.normal(size=(5, 4)))
    trajectory = Trajectory(np.cumsum(rng.random(5)), pose(rotation, rng.normal(size=(5, 3))))
    write_trajectory(trajectory, tmp_path / "a.json")
    back = read_trajectory(tmp_path / "a.json", SIZE)
    np.testing.assert_array_equal(back.times, trajectory.times)
    np.testing.assert_array_equal(back.world_from_vehicle, trajectory.world_from_vehicle)


def test_poses_may_be_positions_and_quaternions(tmp_path):
    half = np.sqrt(0.5)
    file = written(tmp_path, {"times": [0, 1], "positions": [[1, 2, 3]] * 2, "quaternions": [[half, 0, 0, half]] * 2})
    world_from_vehicle = read_trajectory(file, SIZE).world_from_vehicle[1]
    np.testing.assert_allclose(world_from_vehicle, pose(yaw_rotation(np.pi / 2), [1, 2, 3]), atol=1e-12)


def test_poses_of_the_ground_are_lifted_along_the_vehicle(tmp_path):
    header = "# reference: ground_center\nt, x, y, z, heading, pitch, roll\n"
    content = f"{header}0,5,0,1,0,0,0\n1,6,0,1,0,0,{np.pi / 2}\n"
    at = read_trajectory(written(tmp_path, content, "a.csv"), SIZE).world_from_vehicle[:, :3, 3]
    np.testing.assert_allclose(at, [[5, 0, 1.75], [6, -0.75, 1]], atol=1e-9)


def test_angles_of_a_csv_turn_about_z_then_y_then_x(tmp_path):
    content = "t,x,y,z,heading,pitch\n0,0,0,0,0.5,0.1\n0.1,1,0,0,0.5,0.1\n"
    x_axis = read_trajectory(written(tmp_path, content, "a.CSV"), SIZE).world_from_vehicle[0, :3, 0]
    flat = np.cos(0.1)
    np.testing.assert_allclose(x_axis, [flat * np.cos(0.5), flat * np.sin(0.5), -np.sin(0.1)], atol=1e-12)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("{", "not JSON"),
        ([1, 2], 'an object with "times" and poses'),
        ({"times": [0]}, 'poses are given as "world_from_vehicle", or as "positions" and "quaternions"'),
        (
            {"times": [0], "world_from_vehicle": [[1, 2]]},
            '"world_from_vehicle" is a list of T x 4 x 4 finite numbers',
        ),
        (
            {"times": ["a"], "world_from_vehicle": [np.eye(4).tolist()]},
            '"times" is a list of T finite numbers',
        ),
        (
            {"times": [float("nan")], "world_from_vehicle": [np.eye(4).tolist()]},
            '"times" is a list of T finite',
        ),
        ({"times": [1, 0], "world_from_vehicle": [np.eye(4).tolist()] * 2}, "strictly increasing"),
        ({"times": [0, 1], "world_from_vehicle": [np.eye(4).tolist()]}, "one pose per time"),
        (
            {"times": [0], "world_from_vehicle": [np.diag([2.0, 1, 1, 1]).tolist()]},
            "a rotation and a translation",
        ),
        ({"times": [0], "positions": [[0, 0, 0]], "quaternions": [[0, 0, 0, 0]]}, "have length 1"),
        (
            {"times": [0], "positions": [[0, 0, 0]] * 2, "quaternions": [[1, 0, 0, 0]]},
            "2 positions but 1 quaternions",
        ),
        (
            {"times": [0], "world_from_vehicle": [np.eye(4).tolist()], "reference": "rear_axle"},
            "the reference is box_center or ground_center, not 'rear_axle'",
        ),
    ],
)
def test_wrong_json_is_refused_in_a_sentence(tmp_path, content, sentence):
    with pytest.raises(InputError, match=rf"a\.json': .*{sentence}"):
        read_trajectory(written(tmp_path, content), SIZE)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", "it lacks t, x, y, z, heading"),
        ("t,x,y\n0,0,0\n", "it lacks z, heading"),
        ("t,x,y,z,heading\n", "at least|one pose per time"),
        ("t,x,y,z,heading\n0,0,0,0,0\n1,0,zero,0,0\n", "row 2 after the header is not 5 numbers"),
        ("t,x,y,z,heading\n0,0,0,0\n", "row 1 after the header is not 5 numbers"),
        ("t,x,y,z,heading\n0,nan,0,0,0\n", "all numbers are finite"),
        ("# reference: nose\nt,x,y,z,heading\n0,0,0,0,0\n", "not 'nose'"),
    ],
)
def test_a_wrong_csv_is_refused_in_a_sentence(tmp_path, content, sentence):
    with pytest.raises(InputError, match=rf"a\.csv': .*({sentence})"):
        read_trajectory(written(tmp_path, content, "a.csv"), SIZE)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"a \.json or a \.csv file"):
        read_trajectory(tmp_path / "a.xosc", SIZE)
    with pytest.raises(InputError, match="there is no trajectory"):
        read_trajectory(tmp_path / "a.json", SIZE)
    (tmp_path / "a.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot be read as text"):
        read_trajectory(tmp_path / "a.json", SIZE)
