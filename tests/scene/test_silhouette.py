import numpy as np
import pytest

from dwgs.scene import Camera
from dwgs.scene.pose import pose, yaw_rotation
from dwgs.scene.silhouette import box_silhouette, fill_convex_hull


def camera() -> Camera:
    """Looks along +x from the origin, z up."""
    rotation = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    K = np.array([[100, 0, 80], [0, 100, 60], [0, 0, 1]], float)
    return Camera(K, 160, 120, pose(rotation, np.zeros(3)), 0.0)


def test_a_box_seen_straight_on_is_the_rectangle_of_its_near_face():
    mask = box_silhouette(camera(), pose(np.eye(3), [11, 0, 0]), np.array([2, 4, 2.0]))
    expected = np.zeros((120, 160), bool)
    expected[50:70, 60:100] = True
    np.testing.assert_array_equal(mask, expected)


def test_a_margin_widens_the_outline_on_every_side():
    box = pose(np.eye(3), [11, 0, 0]), np.array([2, 4, 2.0])
    mask = box_silhouette(camera(), *box, margin=4)
    assert mask[46:74, 56:104].all()
    assert mask.sum() == 28 * 48


@pytest.mark.parametrize("yaw", [0.3, 1.2, 2.9])
def test_every_point_of_a_turned_box_projects_into_its_silhouette(yaw):
    view, box, size = camera(), pose(yaw_rotation(yaw), [9, 1, -0.4]), np.array([4.2, 1.8, 1.5])
    local = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 3)) * size
    pixels, _ = view.project(local @ box[:3, :3].T + box[:3, 3])
    index = np.floor(pixels).astype(int)
    mask = box_silhouette(view, box, size, margin=1)
    assert mask[index[:, 1], index[:, 0]].all()
    assert box_silhouette(view, box, size).sum() < mask.sum() < 1.3 * box_silhouette(view, box, size).sum()


def test_a_box_that_reaches_behind_the_camera_is_cut_not_mirrored():
    beside = box_silhouette(camera(), pose(np.eye(3), [0, 2, 0]), np.array([20, 2, 2.0]))
    assert beside[:, :70].any()
    assert not beside[:, 80:].any()
    assert not box_silhouette(camera(), pose(np.eye(3), [-10, 0, 0]), np.array([4, 2, 2.0])).any()


def test_a_hull_without_points_covers_nothing():
    assert not fill_convex_hull(np.zeros((0, 2)), 5, 4).any()
