import numpy as np

from dwgs.reconstruct.unseen import continue_colors, meet_ground, road_seen
from dwgs.scene import Camera
from dwgs.scene.ground import Ground
from dwgs.scene.pose import pose

SLOPE = Ground(np.array([0.02, 0.0, -1.0]), np.array([-50.0, -50.0]), np.zeros((200, 200)))
"""The plane z = 0.02 x - 1."""


def test_rays_come_down_where_the_ground_is_and_only_if_they_do():
    origin = np.array([0.0, 0, 1.5])
    rays = np.array([[1.0, 0, -0.2], [1, 0.3, -0.1], [1, 0, 0.1], [1, 0, 0.019]])
    points, arrives = meet_ground(SLOPE, origin, rays)
    assert arrives.tolist() == [True, True, False, False]
    np.testing.assert_allclose(points[:2, 2], SLOPE.height(points[:2, :2]), atol=1e-2)


def test_road_points_are_about_as_far_apart_as_they_say():
    rotation = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    camera = Camera(np.array([[80, 0, 48], [0, 80, 28], [0, 0, 1]], float), 96, 64, pose(rotation, [0, 0, 1.5]), 0)
    mask = np.zeros((64, 96), bool)
    mask[40:60, 20:70] = True
    points, spacing = road_seen(SLOPE, camera, mask)
    pixels, _ = camera.project(points)
    assert mask[tuple(np.floor(pixels).astype(int).T[::-1])].all()
    distances = np.linalg.norm(points[:, None, :2] - points[None, ::97, :2], axis=-1)
    nearest = np.sort(distances, axis=0)[1]
    assert (nearest < spacing[::97]).all()


def test_unknown_road_takes_the_colour_of_the_road_around_it():
    xy = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), -1).reshape(-1, 2)
    points = np.column_stack([xy, np.zeros(len(xy))])
    colors = np.column_stack([xy[:, 0] / 20, np.full(len(xy), 0.5), np.full(len(xy), 0.5)])
    unknown = (np.abs(xy - 9.5) < 3).all(1)
    colors[unknown] = 9
    filled = continue_colors(points, colors, ~unknown, unknown)
    assert (filled[~unknown] == colors[~unknown]).all()
    assert np.abs(filled[unknown, 0] - xy[unknown, 0] / 20).max() < 0.12
    assert (continue_colors(points, colors, np.zeros(len(xy), bool), unknown) == colors).all()
