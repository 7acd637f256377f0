import numpy as np
import pytest
from random_world import HEIGHT, WIDTH, random_cloud

from dwgs.scene import Gaussians, Trajectory, VehicleAsset
from dwgs.scene.insertion import box_corners
from viewer.orbit import BACKDROP, FILLED, orbit_cameras
from viewer.scene_graph import SceneGraph


def asset(size=(4.5, 1.9, 1.5)) -> VehicleAsset:
    rng, size = np.random.default_rng(0), np.array(size)
    body = random_cloud(rng, 400, -size / 2.2, size / 2.2, 0.12, 1)
    n = 200
    shadow = Gaussians(
        (rng.uniform(-0.6, 0.6, (n, 3)) * size * [1, 1, 0] - [0, 0, size[2] / 2]).astype(np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.tile(np.float32([0.3, 0.3, 0.005]), (n, 1)),
        np.full(n, 0.2, np.float32),
        np.full((n, 1, 3), -1.7, np.float32),
    )
    return VehicleAsset(body, shadow, size)


@pytest.mark.parametrize("elevation", [0.0, 0.24, 1.2])
@pytest.mark.parametrize("size", [(4.5, 1.9, 1.5), (12, 2.5, 3.5), (0.6, 0.6, 1.8)])
@pytest.mark.parametrize(("width", "height"), [(720, 480), (300, 900)])
def test_the_box_fits_into_every_image_and_fills_the_largest(elevation, size, width, height):
    reach = []
    for view in orbit_cameras(asset(size), 24, width, height, elevation):
        pixels, depths = view.project(box_corners(np.array(size)))
        assert (depths > 0).all()
        reach.append(abs(pixels / [width, height] * 2 - 1).max())
    assert max(reach) == pytest.approx(FILLED)


def test_cameras_go_once_round_at_one_height_and_look_at_the_asset():
    cameras = orbit_cameras(asset(), 8, 720, 480, elevation=0.3)
    positions = np.array([view.position for view in cameras])
    azimuths = np.unwrap(np.arctan2(positions[:, 1], positions[:, 0]))
    np.testing.assert_allclose(np.diff(azimuths), np.pi / 4)
    np.testing.assert_allclose(positions[:, 2] / np.linalg.norm(positions, axis=1), np.sin(0.3))
    for view in cameras:
        np.testing.assert_allclose(view.project(np.zeros((1, 3)))[0], [[360, 240]])
        assert view.camera_from_world[1, 2] < 0  # up in the world is up in the image


def test_the_shadow_darkens_a_light_ground(renderer):
    view = orbit_cameras(asset(), 1, WIDTH, HEIGHT)[0]
    whole = asset()
    bare = VehicleAsset(whole.body, Gaussians.empty(), whole.size)
    here = Trajectory(np.zeros(1), np.eye(4)[None])
    with_shadow, without = (
        renderer.render(SceneGraph(None, [(shown, here)], BACKDROP), view) for shown in (whole, bare)
    )
    ground = without.alpha == 0
    assert without.rgb[ground].min() > 0.6
    assert (with_shadow.rgb[ground] <= without.rgb[ground] + 1e-5).all()
    assert (without.rgb[ground] - with_shadow.rgb[ground]).max() > 0.2


def test_the_studio_is_brightest_at_the_horizon_and_has_no_edge():
    gray = BACKDROP[:, 0, 0]
    assert abs(int(np.argmax(gray)) - len(gray) / 2) <= 1
    assert abs(np.diff(gray)).max() < 0.01
