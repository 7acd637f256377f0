import subprocess
import sys
from dataclasses import replace

import moderngl
import numpy as np
import pytest
from random_world import AHEAD, camera, psnr, random_cloud

from dwgs.scene import Background, Gaussians, InputError, Trajectory, VehicleAsset
from dwgs.scene.pose import pose, rotation_from_quat
from dwgs.scene.sky import sky_image
from viewer.renderer import Renderer
from viewer.scene_graph import SceneGraph

GRAY = np.full((1, 1, 3), 0.25, np.float32)
SH_DC = 0.28209479177387814


def sheet(depth, color, opacity=1.0) -> Gaussians:
    """One flat Gaussian across the whole view, square to it."""
    one = np.ones((1, 3), np.float32)
    return Gaussians(
        np.array([[depth, 0, 1.5]], np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
        np.array([[1e-3, 1e3, 1e3]], np.float32),
        np.full(1, opacity, np.float32),
        ((np.array(color) - 0.5) / SH_DC * one)[:, None].astype(np.float32),
    )


def standing(*clouds) -> SceneGraph:
    nothing, here = Gaussians.empty(), Trajectory(np.array([0.0, 1.0]), np.eye(4)[None].repeat(2, 0))
    assets = [VehicleAsset(cloud, nothing, np.ones(3)) for cloud in clouds]
    return SceneGraph(None, [(asset, here) for asset in assets], GRAY)


def test_an_empty_scene_shows_its_backdrop(renderer):
    image = renderer.render(SceneGraph(None, [], GRAY), camera())
    assert image.rgb.shape == (80, 120, 3)
    assert (image.rgb == 0.25).all()
    assert (image.alpha == 0).all()
    assert (image.depth == 0).all()


@pytest.mark.parametrize("yaw", [0.0, 1.2, np.pi, 4.0])
@pytest.mark.parametrize("pitch", [-1.5, 0.0, 1.5])
def test_the_sky_is_where_the_scene_says(renderer, yaw, pitch):
    sky = np.random.default_rng(1).random((9, 14, 3)).astype(np.float32)
    turn = rotation_from_quat([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    tilt = rotation_from_quat([np.cos(pitch / 2), np.sin(pitch / 2), 0, 0])
    view = camera(turn @ AHEAD @ tilt)
    seen = renderer.render(SceneGraph(Background(Gaussians.empty(), sky)), view)
    np.testing.assert_allclose(seen.rgb, sky_image(sky, view), atol=2e-5)


def test_one_sheet_is_composited_by_the_book(renderer):
    image = renderer.render(standing(sheet(7.0, (0.9, 0.6, 0.2), 0.5)), camera())
    np.testing.assert_allclose(image.alpha, 0.5, rtol=1e-3)
    np.testing.assert_allclose(image.rgb, 0.5 * np.array([0.9, 0.6, 0.2]) + 0.5 * 0.25 + 0 * image.rgb, atol=1e-3)
    np.testing.assert_allclose(image.depth, 7.0, rtol=1e-5)


def test_no_splat_hides_all_and_a_faint_one_is_not_drawn(renderer):
    assert renderer.render(standing(sheet(7.0, (1, 1, 1), 1.0)), camera()).alpha.max() == np.float32(0.99)
    assert renderer.render(standing(sheet(7.0, (1, 1, 1), 0.9 / 255)), camera()).alpha.max() == 0


def test_what_is_near_hides_what_is_far_across_objects(renderer):
    red, green, blue = sheet(3.0, (1, 0, 0)), sheet(5.0, (0, 1, 0)), sheet(4.0, (0, 0, 1))
    both = Gaussians.concatenate([red, green])  # the blue sheet of another object lies between them
    color = renderer.render(standing(both, blue), camera()).rgb[40, 60]
    np.testing.assert_allclose(color, [0.99, 0.01 * 0.01 * 0.99, 0.01 * 0.99], atol=1e-5)


def test_only_what_lies_before_the_camera_is_drawn(renderer):
    for depth in (-3.0, 0.0, 0.04):
        assert renderer.render(standing(sheet(depth, (1, 1, 1))), camera()).alpha.max() == 0


def test_the_order_of_gaussians_and_of_objects_changes_nothing(renderer, street):
    rng = np.random.default_rng(0)
    shuffled = street.background.gaussians[rng.permutation(len(street.background.gaussians))]
    other = SceneGraph(replace(street.background, gaussians=shuffled), street.actors[::-1])
    first, second = renderer.render(street, camera()), renderer.render(other, camera())
    np.testing.assert_array_equal(first.rgb, second.rgb)
    np.testing.assert_array_equal(first.depth, second.depth)


def test_the_same_call_gives_the_same_bytes_whatever_was_drawn_between(renderer, street):
    first = renderer.render(street, camera()).rgb.tobytes()
    renderer.render(SceneGraph(None, [], GRAY), camera())
    renderer.render(SceneGraph(street.background), camera())
    assert renderer.render(street, camera()).rgb.tobytes() == first


def test_a_vehicle_and_a_camera_that_move_together_see_the_same(renderer):
    rng = np.random.default_rng(3)
    asset = VehicleAsset(random_cloud(rng, 400, (-2, -1, -1), (2, 1, 1)), Gaussians.empty(), np.array([4.0, 2, 2]))
    relative = pose(AHEAD, [-6.0, 0.2, 0.3])  # vehicle_from_camera
    images = []
    for quat, position in (([1, 0, 0, 0], [0, 0, 0]), ([0.5, 0.2, -0.4, 0.9], [300, -200, 9])):
        world_from_vehicle = pose(rotation_from_quat(quat), position)
        trajectory = Trajectory(np.array([0.5]), world_from_vehicle[None])
        view = camera().at(world_from_vehicle @ relative)
        images.append(renderer.render(SceneGraph(None, [(asset, trajectory)], GRAY), view))
    assert images[0].alpha.max() > 0.9
    assert psnr(images[0].rgb, images[1].rgb) > 90


def test_a_vehicle_is_there_only_while_its_trajectory_lasts(renderer, street):
    empty = SceneGraph(street.background)
    for time, is_there in ((-0.1, False), (0.0, True), (1.0, True), (1.1, False)):
        view = camera(time=time)
        same = (renderer.render(street, view).rgb == renderer.render(empty, view).rgb).all()
        assert same != is_there


def test_one_asset_can_drive_twice(renderer, street):
    asset, trajectory = street.actors[0]
    elsewhere = trajectory.moved(pose(np.eye(3), [2, 1, 0]))
    twin = VehicleAsset(*(replace(c, means=c.means.copy()) for c in (asset.body, asset.shadow)), asset.size)
    shared = renderer.render(SceneGraph(None, [(asset, trajectory), (asset, elsewhere)]), camera())
    separate = renderer.render(SceneGraph(None, [(asset, trajectory), (twin, elsewhere)]), camera())
    np.testing.assert_array_equal(shared.rgb, separate.rgb)


def test_exposure_is_a_gain_on_the_finished_colour(renderer, street):
    gain = np.array([0.5, 1.0, 1.5], np.float32)
    plain, exposed = renderer.render(street, camera()), renderer.render(street, camera(), gain)
    np.testing.assert_allclose(exposed.rgb, plain.rgb * gain, rtol=1e-6)
    np.testing.assert_array_equal(exposed.depth, plain.depth)


def test_two_renderers_do_not_disturb_each_other(renderer, street):
    before = renderer.render(street, camera()).rgb
    with Renderer(60, 40) as small:
        half = small.render(street, camera().resize(60, 40)).rgb
    assert half.shape == (40, 60, 3)
    np.testing.assert_array_equal(renderer.render(street, camera()).rgb, before)


def test_a_camera_of_another_size_is_refused(renderer):
    with pytest.raises(InputError, match="draws 120x80, the camera 60x40"):
        renderer.render(SceneGraph(None), camera().resize(60, 40))


def test_a_machine_that_cannot_draw_is_told_which_packages_it_lacks(monkeypatch):
    def fail(**_):
        raise Exception("libEGL.so.1 not loaded")

    monkeypatch.setattr(moderngl, "create_context", fail)
    with pytest.raises(InputError, match="libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"):
        Renderer(8, 8)


def test_the_viewer_starts_quickly_and_quietly_without_torch_or_warp():
    code = (
        "import time; start = time.perf_counter(); import viewer.orbit, viewer.renderer, sys;"
        "assert time.perf_counter() - start < 1; assert not {'torch', 'warp', 'scipy'} & sys.modules.keys()"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
