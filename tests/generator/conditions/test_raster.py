import numpy as np
import pytest
from toy_vehicle import LOOK_ALONG_X, SIZE, box_points

from dwgs.scene import Camera, VehiclePoints
from dwgs.scene.pose import pose
from generator.conditions.raster import GREY, PointRasterizer

AHEAD = pose(np.eye(3), [10.0, 0, 0])


def camera(width: int = 720, height: int = 480) -> Camera:
    K = np.array([[500, 0, width / 2], [0, 500, height / 2], [0, 0, 1]], float)
    return Camera(K, width, height, pose(LOOK_ALONG_X, np.zeros(3)), 0.0)


def single(offset: tuple[float, float] = (0.0, 0.0), count: int = 1) -> VehiclePoints:
    """Points on the optical axis, moved by ``offset`` [px] in the image at 10 m."""
    points = np.tile([0, -offset[0] / 50, -offset[1] / 50], (count, 1)).astype(np.float32)
    return VehiclePoints(points, np.full((count, 3), 255, np.uint8))


def test_a_disc_is_a_parabola_of_1_2_pixels_at_480_rows_around_the_projected_point():
    image, _ = PointRasterizer(single((0.3, -0.2))).draw(camera(), AHEAD)
    y, x = np.mgrid[:480, :720] + 0.5
    alpha = np.clip(1 - ((x - 360.3) ** 2 + (y - 239.8) ** 2) / 1.2**2, 0, 1)
    np.testing.assert_allclose(image[..., 0], GREY + (255 - GREY) * alpha, atol=0.6)


def test_the_disc_does_not_shrink_with_distance():
    near, _ = PointRasterizer(single()).draw(camera(), pose(np.eye(3), [5.0, 0, 0]))
    far, _ = PointRasterizer(single()).draw(camera(), pose(np.eye(3), [80.0, 0, 0]))
    np.testing.assert_array_equal(near, far)


def test_no_more_than_ten_discs_blend_in_a_pixel():
    image, _ = PointRasterizer(single((0.5, 1.55), 30)).draw(camera(), AHEAD)
    alpha = 1 - 1.05**2 / 1.2**2  # in the pixel above the one that the points fall into
    assert image[240, 360, 0] == round(GREY + (255 - GREY) * (1 - (1 - alpha) ** 10))


def test_the_nearer_point_covers_the_farther():
    points = np.array([[0, 0, 0], [0.1, 0, 0]], np.float32)
    colors = np.array([[255, 0, 0], [0, 255, 0]], np.uint8)
    for order in ([0, 1], [1, 0]):
        image, _ = PointRasterizer(VehiclePoints(points[order], colors[order])).draw(camera(), AHEAD)
        r, g, _ = image[240, 360].astype(int)
        assert r > g


@pytest.mark.parametrize("with_normals", [True, False])
def test_the_far_side_does_not_shine_through_between_the_discs_of_the_near_side(with_normals: bool):
    vehicle = box_points(SIZE, 20_000)
    if not with_normals:
        vehicle = VehiclePoints(vehicle.points, vehicle.colors)
    image, mask = PointRasterizer(vehicle).draw(camera(), AHEAD)  # seen from behind: the red side only
    assert mask.sum() > 1000
    inside = image[220:260, 310:410] if not with_normals else image  # the sides begin at the outline
    assert (inside[..., 2] <= GREY).all()


def test_points_behind_the_camera_or_beside_the_image_draw_nothing():
    for position in ([-5.0, 0, 0], [10.0, 30, 0]):
        image, mask = PointRasterizer(box_points(SIZE)).draw(camera(), pose(np.eye(3), position))
        assert (image == GREY).all()
        assert not mask.any()


def test_a_small_image_still_shows_every_point():
    for offset in ((0.0, 0.0), (0.5, 0.5), (0.25, 0.75)):
        _, mask = PointRasterizer(single(offset)).draw(camera(72, 48), AHEAD)
        image, _ = PointRasterizer(single(offset)).draw(camera(72, 48), AHEAD)
        assert (image != GREY).any()
        assert mask.dtype == bool


def test_order_of_points_changes_nothing():
    vehicle = box_points(SIZE)
    shuffled = np.random.default_rng(0).permutation(len(vehicle.points))
    assert vehicle.normals is not None
    other = VehiclePoints(vehicle.points[shuffled], vehicle.colors[shuffled], vehicle.normals[shuffled], True)
    first, second = (PointRasterizer(v).draw(camera(), AHEAD)[0] for v in (vehicle, other))
    assert np.abs(first.astype(int) - second).max() <= 1


def test_one_point_alone_is_a_vehicle_too():
    _, mask = PointRasterizer(single((0.5, 0.5))).draw(camera(), AHEAD)
    assert mask.sum() == pytest.approx(1, abs=1)
