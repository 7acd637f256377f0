import numpy as np
import pytest
import trimesh

from dwgs.distill.exposure import is_exposed, is_seen

HALF = np.array([2.0, 0.9, 0.7])


def surface(share=1.0, count=40_000):
    """Points on a box."""
    return trimesh.sample.sample_surface(trimesh.creation.box(2 * share * HALF), count, seed=0)[0].astype(np.float32)


@pytest.mark.parametrize(("eye", "axis", "sign"), [((0, 8, 0), 1, 1), ((-9, 0, 0.2), 0, -1), ((0, 0, 6), 2, 1)])
def test_an_eye_sees_the_side_that_faces_it(eye, axis, sign):
    points = surface()
    seen = is_seen(points, [np.array(eye, float)])
    facing = points[:, axis] * sign > HALF[axis] - 1e-3
    assert seen[facing].mean() > 0.97
    assert seen[points[:, axis] * sign < 0].mean() < 0.03


def test_a_nearer_box_hides_the_one_behind_it():
    points = np.concatenate([surface(), surface() + np.float32([0, -6, 0])])
    seen = is_seen(points, [np.array([0, 9.0, 0])])
    assert seen[:40_000].any()
    assert seen[40_000:].mean() < 0.03


def test_two_eyes_see_what_either_sees():
    points, left, right = surface(), np.array([0, 8.0, 0]), np.array([0, -8.0, 0])
    both = is_seen(points, [left, right])
    np.testing.assert_array_equal(both, is_seen(points, [left]) | is_seen(points, [right]))


def test_what_is_inside_shows_from_nowhere():
    points = np.concatenate([surface(), surface(0.6)])
    exposed = is_exposed(points)
    sides_and_top = points[:40_000, 2] > -0.99 * HALF[2]
    assert exposed[:40_000][sides_and_top].mean() > 0.97
    assert exposed[40_000:].mean() < 0.03


def test_nothing_behind_an_eye_or_right_beside_it_is_seen():
    assert not is_seen(surface(0.01), [np.zeros(3)]).any()
    assert not is_seen(surface(), []).any()
