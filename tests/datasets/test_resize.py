"""Scenes at working size."""

from dataclasses import replace

import numpy as np
import pytest

from dwgs.datasets import resize_scene
from dwgs.scene import Camera, Frame, InputError, Scene, Trajectory

K = np.array([[100.0, 0, 96.5], [0, 110, 54.5], [0, 0, 1]])


def scene_of(pixels: np.ndarray, load=None, mask=None) -> Scene:
    height, width = pixels.shape[:2]
    camera = Camera(K, width, height, np.eye(4), 0.0)
    frame = Frame(0, "front", camera, load or (lambda: pixels), None if mask is None else lambda: mask)
    return Scene("drive", {"front": (frame,)}, Trajectory(np.zeros(1), np.eye(4)[None]))


def disc(width: int, height: int, x: float, y: float, radius: float) -> np.ndarray:
    grid_y, grid_x = np.mgrid[:height, :width] + 0.5
    inside = np.hypot(grid_x - x, grid_y - y) < radius
    return np.repeat((255 * inside).astype(np.uint8)[..., None], 3, 2)


@pytest.mark.parametrize("size", [(72, 48), (48, 48), (100, 25), (63, 41)])
def test_what_a_point_projects_to_is_what_the_image_shows(size):
    """A disc drawn where a point projects is found where the resized camera projects that point."""
    point = np.array([[0.12, 0.25, 1.0]])
    scene = scene_of(np.zeros((108, 192, 3), np.uint8))
    x, y = scene.frames["front"][0].camera.project(point)[0][0]
    small = resize_scene(scene_of(disc(192, 108, x, y, 8)), *size).frames["front"][0]
    light = small.pixels[..., 0].astype(float)
    grid_y, grid_x = np.mgrid[: size[1], : size[0]] + 0.5
    centre = np.array([(light * grid_x).sum(), (light * grid_y).sum()]) / light.sum()
    np.testing.assert_allclose(small.camera.project(point)[0][0], centre, atol=0.05)


def test_columns_go_from_both_sides_and_rows_from_the_top():
    wide = resize_scene(scene_of(np.zeros((100, 200, 3), np.uint8)), 50, 50).frames["front"][0].camera
    np.testing.assert_allclose(wide.K[:2, 2], ((96.5 - 50) / 2, 54.5 / 2))
    tall = resize_scene(scene_of(np.zeros((100, 100, 3), np.uint8)), 100, 40).frames["front"][0].camera
    np.testing.assert_allclose(tall.K[:2, 2], (96.5, 54.5 - 60))


def test_an_image_is_read_once_and_each_caller_gets_its_own():
    reads = []

    def load():
        reads.append(1)
        return np.full((100, 200, 3), 7, np.uint8)

    frame = resize_scene(scene_of(np.zeros((100, 200, 3), np.uint8), load), 20, 10).frames["front"][0]
    assert not reads
    frame.pixels[:] = 0
    assert (frame.pixels == 7).all()
    assert len(reads) == 1


def test_a_reactive_mask_holds_every_pixel_that_it_touched():
    mask = np.zeros((100, 200), bool)
    mask[50, 100] = True
    scene = scene_of(np.zeros((100, 200, 3), np.uint8), mask=mask)
    small = resize_scene(scene, 20, 10).frames["front"][0].reactive_mask
    assert small.dtype == bool
    assert np.argwhere(small).tolist() == [[5, 10]]
    assert resize_scene(scene_of(np.zeros((100, 200, 3), np.uint8)), 20, 10).frames["front"][0].reactive_mask is None


def test_the_same_size_changes_nothing():
    scene = scene_of(disc(64, 48, 20, 20, 5))
    assert resize_scene(scene, 64, 48).frames["front"][0] is scene.frames["front"][0]
    assert resize_scene(replace(scene, name="other"), 64, 48).name == "other"


def test_a_size_without_pixels_is_refused():
    with pytest.raises(InputError, match="asked for 0x48"):
        resize_scene(scene_of(np.zeros((10, 10, 3), np.uint8)), 0, 48)
