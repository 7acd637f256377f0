import numpy as np

from dwgs.scene import Camera
from dwgs.scene.pose import pose, yaw_rotation
from dwgs.scene.sky import pixel_rays, sky_image

AHEAD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
"""world_from_camera rotation that looks along +x."""


def camera(rotation=AHEAD) -> Camera:
    K = np.array([[90, 0, 41], [0, 95, 28], [0, 0, 1]], float)
    return Camera(K, 80, 60, pose(rotation, [3, 4, 5]), 0.0)


def test_a_ray_projects_back_into_its_pixel():
    rays = pixel_rays(camera()).reshape(-1, 3)
    pixels, depths = camera().project(camera().position + 7 * rays)
    x, y = np.meshgrid(np.arange(80) + 0.5, np.arange(60) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([x.ravel(), y.ravel()], -1), atol=1e-9)
    np.testing.assert_allclose(depths, 7)


def test_a_sky_that_is_a_function_of_direction_is_seen_as_that_function():
    height, width = 256, 512
    azimuth = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    polar = (np.arange(height)[:, None] + 0.5) / height * np.pi
    towards = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth]
    sky = (0.5 + 0.5 * np.stack(towards, -1)).astype(np.float32)
    for yaw in (0.0, 1.0, np.pi):
        view = camera(yaw_rotation(yaw) @ AHEAD)
        rays = pixel_rays(view)
        expected = 0.5 + 0.5 * rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        np.testing.assert_allclose(sky_image(sky, view), expected, atol=1e-3)
