import numpy as np

from dwgs.reconstruct.discs import SH_DC, discs, sh_of_color
from dwgs.reconstruct.thinning import spacing_in_view, thin
from dwgs.scene import Camera
from dwgs.scene.pose import pose, rotation_from_quat


def test_discs_lie_in_the_plane_of_their_points_and_close_it():
    rng = np.random.default_rng(0)
    normal = np.array([0.6, 0.0, 0.8])
    along = np.stack([[0, 1, 0], np.cross(normal, [0, 1, 0])])
    points = rng.uniform(-1, 1, (500, 2)) @ along
    n = len(points)
    cloud = discs(points, np.full(n, 0.1), 0.8)
    thinnest = rotation_from_quat(cloud.quats)[:, :, 2]
    assert np.abs(thinnest @ normal).min() > 0.99
    assert (cloud.scales[:, 2] < 0.5 * cloud.scales[:, 0]).all()
    assert 0.02 < np.median(cloud.scales[:, 0]) < 0.15
    assert (cloud.opacities == np.float32(0.8)).all()


def test_a_colour_is_shown_from_every_side():
    colors = np.random.default_rng(0).uniform(0, 1, (5, 3))
    sh = sh_of_color(colors)
    np.testing.assert_allclose(0.5 + SH_DC * sh[:, 0], colors, atol=1e-6)
    assert not sh[:, 1:].any()


def test_points_are_thinned_to_what_the_nearest_camera_resolves():
    K = np.array([[100, 0, 50], [0, 100, 50], [0, 0, 1]], float)
    rotation = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    cameras = [Camera(K, 100, 100, pose(rotation, [x, 0, 0]), 0.0) for x in (0, 5)]
    behind_and_before = np.array([[-3, 0, 0], [15, 0, 0], [15, 100, 0]], np.float32)
    np.testing.assert_allclose(spacing_in_view(behind_and_before, cameras), [np.inf, 0.3, np.inf])

    points = np.random.default_rng(0).uniform(0, 1, (20_000, 3)).astype(np.float32)
    sizes = np.where(points[:, 0] < 0.5, 0.1, 0.2).astype(np.float32)
    kept, kept_sizes = thin(points, sizes)
    near = kept[:, 0] < 0.5
    assert 4 < near.sum() / (~near).sum() < 9
    np.testing.assert_allclose(np.unique(kept_sizes), 2.0 ** (np.round(2 * np.log2([0.1, 0.2])) / 2))
