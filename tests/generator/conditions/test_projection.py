import numpy as np
from toy_vehicle import LOOK_ALONG_X, SIZE, box_points

from dwgs.scene import Camera, VehiclePoints
from dwgs.scene.pose import pose
from generator.conditions.projection import PointProjector
from generator.conditions.raster import GREY, PointRasterizer

AHEAD = pose(np.eye(3), [10.0, 0, 0])
CAMERA = Camera(np.array([[500, 0, 360], [0, 500, 240], [0, 0, 1]], float), 720, 480, pose(LOOK_ALONG_X, [0, 0, 0]), 0)


def test_a_point_colours_its_pixel_and_nothing_else():
    vehicle = VehiclePoints(np.float32([[0, -0.01, -0.03]]), np.uint8([[10, 20, 30]]))
    image, mask = PointProjector(vehicle).draw(CAMERA, AHEAD)
    assert np.argwhere(mask).tolist() == [[241, 360]]
    assert image[241, 360].tolist() == [10, 20, 30]
    assert (image[~mask] == GREY).all()


def test_the_nearest_point_wins():
    points = np.float32([[1, 0, 0], [-1, 0, 0], [0, 0, 0]])
    image, mask = PointProjector(VehiclePoints(points, np.uint8([[1] * 3, [2] * 3, [3] * 3]))).draw(CAMERA, AHEAD)
    assert mask.sum() == 1
    assert image[mask].tolist() == [[2, 2, 2]]


def test_unlike_discs_it_shows_the_far_side_through_the_near_one():
    near, far = (
        np.float32([[x, 0.01 * y, 0.01 * z] for y in range(-9, 9, step) for z in range(-9, 9, step)])
        for x, step in ((-1, 2), (1, 1))
    )
    colors = np.uint8([[200] * 3] * len(near) + [[20] * 3] * len(far))
    vehicle = VehiclePoints(np.concatenate([near, far]), colors)
    shown, hidden = (drawer(vehicle).draw(CAMERA, AHEAD)[0] for drawer in (PointProjector, PointRasterizer))
    assert (shown < 100).any()
    assert not (hidden < 100).any()


def test_nothing_behind_the_camera_is_drawn():
    behind = pose(np.eye(3), [-10.0, 0, 0])
    assert not PointProjector(box_points(SIZE)).draw(CAMERA, behind)[1].any()
