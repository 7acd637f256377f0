import numpy as np

from dwgs.reconstruct.sky import SHELL_RADIUS, far_shell, paint_sky
from dwgs.scene.sky import sky_colors

ROAD = np.array([0.2, 0.25, 0.3])


def test_a_sky_keeps_what_was_seen_continues_it_and_has_road_below():
    rng = np.random.default_rng(0)
    seen = rng.normal([1, 0, 0.5], 0.1, (4000, 3))
    sky = paint_sky(seen, np.tile([0.5, 0.6, 0.9], (4000, 1)), ROAD)
    assert sky.dtype == np.float32
    np.testing.assert_allclose(sky_colors(sky, seen[:50]), np.tile([0.5, 0.6, 0.9], (50, 1)), atol=1e-4)
    behind = np.array([[-1.0, 0, 0.2], [-1, 0.01, 0.2], [0, 0, 1]])
    np.testing.assert_allclose(sky_colors(sky, behind), np.tile([0.5, 0.6, 0.9], (3, 1)), atol=1e-2)
    np.testing.assert_allclose(sky_colors(sky, np.array([[1.0, 0, -0.3]])), ROAD[None], atol=1e-4)


def test_without_a_seen_sky_all_is_road():
    assert np.allclose(paint_sky(np.zeros((0, 3)), np.zeros((0, 3)), ROAD), ROAD)


def test_the_first_colour_of_a_direction_counts_and_the_shell_is_far():
    directions = np.array([[2.0, 0, 0], [1, 0, 0], [0, 3, 0]])
    colors = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    shell = far_shell(np.array([10.0, 0, 0]), directions, colors, focal=500)
    np.testing.assert_allclose(shell.means, [[10 + SHELL_RADIUS, 0, 0], [10, SHELL_RADIUS, 0]], atol=1e-2)
    assert shell.sh[0, 0, 0] > 0 > shell.sh[0, 0, 1]
