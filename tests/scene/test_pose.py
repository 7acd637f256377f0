"""Rigid transforms and their quaternions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dwgs.scene.pose import (
    inverse,
    is_rigid,
    pitch_rotation,
    pose,
    quat_from_rotation,
    quat_product,
    rotation_from_quat,
    slerp,
    transform_points,
    yaw_rotation,
)

finite = st.floats(-1, 1, allow_nan=False)
quats = (
    st.tuples(finite, finite, finite, finite)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: np.array(q) / np.linalg.norm(q))
)


@given(quats)
def test_a_quaternion_comes_back_from_its_rotation(quat):
    back = quat_from_rotation(rotation_from_quat(quat))
    assert back[0] >= 0
    np.testing.assert_allclose(np.abs(back @ quat), 1, atol=1e-9)


@given(quats, st.tuples(finite, finite, finite))
def test_an_inverse_undoes_its_transform(quat, translation):
    a_from_b = pose(rotation_from_quat(quat), np.array(translation))
    assert is_rigid(a_from_b)
    np.testing.assert_allclose(inverse(a_from_b) @ a_from_b, np.eye(4), atol=1e-12)
    points = np.arange(12.0).reshape(4, 3)
    np.testing.assert_allclose(
        transform_points(inverse(a_from_b), transform_points(a_from_b, points)), points, atol=1e-9
    )


@given(quats, quats)
def test_slerp_begins_and_ends_where_it_should_and_stays_unit(a, b):
    for s, end in ((0.0, a), (1.0, b)):
        np.testing.assert_allclose(np.abs(slerp(a, b, s) @ end), 1, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(slerp(a, b, np.linspace(0, 1, 7))[..., :], axis=-1), 1)


def test_yaw_turns_x_towards_y():
    np.testing.assert_allclose(yaw_rotation(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_a_reflection_is_not_rigid():
    assert not is_rigid(np.diag([1.0, 1, -1, 1]))
    assert not is_rigid(np.full((4, 4), np.nan))


@given(quats, quats)
def test_a_product_of_quaternions_turns_by_one_after_the_other(a, b):
    both = rotation_from_quat(a) @ rotation_from_quat(b)
    np.testing.assert_allclose(rotation_from_quat(quat_product(a, b)), both, atol=1e-9)


def test_what_looks_up_pitches_ahead():
    np.testing.assert_allclose(pitch_rotation(np.pi / 2) @ [0, 0, 1], [1, 0, 0], atol=1e-12)
