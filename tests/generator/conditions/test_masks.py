import numpy as np
from toy_vehicle import LOOK_ALONG_X, SIZE, box_points

from dwgs.scene import Camera
from dwgs.scene.pose import pose, yaw_rotation
from generator.conditions.masks import inactive_image, reactive_mask
from generator.conditions.raster import GREY, PointRasterizer

K = np.array([[300, 0, 180], [0, 300, 120], [0, 0, 1]], float)
CAMERA = Camera(K, 360, 240, pose(LOOK_ALONG_X, [0, 0, 1.5]), 0.0)
POSES = [pose(yaw_rotation(yaw), [x, y, SIZE[2] / 2]) for yaw, x, y in [(0, 8, 0), (1, 6, 3), (3, 2, -2), (0.3, 1, 2)]]


def test_the_region_holds_every_point_that_is_drawn():
    rasterizer = PointRasterizer(box_points(SIZE, 20_000))
    for world_from_vehicle in POSES:
        _, drawn = rasterizer.draw(CAMERA, world_from_vehicle)
        assert not (drawn & ~reactive_mask(CAMERA, world_from_vehicle, SIZE)).any()


def test_a_box_that_reaches_behind_the_camera_is_cut_and_not_mirrored():
    mask = reactive_mask(CAMERA, pose(np.eye(3), [0.5, 2.0, 0.75]), SIZE)  # beside us, on the left
    assert mask[120:, 0].all()
    assert not mask[:, 200:].any()


def test_the_shadow_widens_the_region_on_the_ground_alone():
    world_from_vehicle = pose(np.eye(3), [12, 0, SIZE[2] / 2])
    plain = reactive_mask(CAMERA, world_from_vehicle, SIZE, shadow_margin=0)
    wide = reactive_mask(CAMERA, world_from_vehicle, SIZE, shadow_margin=0.6)
    assert (wide | plain == wide).all()
    added = np.flatnonzero((wide & ~plain).any(1))
    ground = 120 + 300 * 1.5 / 14  # row where the far end of the box meets the ground
    assert added.min() > ground - 8
    beside = np.flatnonzero((wide & ~plain).any(0))
    assert beside[-1] - beside[0] > 300 * (1.8 + 1.0) / 10


def test_behind_the_camera_there_is_no_region():
    assert not reactive_mask(CAMERA, pose(np.eye(3), [-10, 0, 0.75]), SIZE).any()


def test_the_inactive_image_is_the_recording_with_a_grey_hole():
    pixels = np.random.default_rng(0).integers(0, 255, (4, 5, 3)).astype(np.uint8)
    mask = np.zeros((4, 5), bool)
    mask[1:3, 2:4] = True
    hole = inactive_image(pixels, mask)
    assert hole.dtype == np.uint8
    assert (hole[mask] == GREY).all()
    np.testing.assert_array_equal(hole[~mask], pixels[~mask])
