from dataclasses import replace

import numpy as np
import pytest
import torch

from dwgs.distill.layers import FrozenBackground, depth_interval, fingerprint
from dwgs.scene import Background
from dwgs.scene.pose import pose, yaw_rotation
from dwgs.scene.sky import sky_image
from dwgs.splat import Splats, View, composite, project

TOLERANCE = 2e-4
"""What the stopping rule may leave out, counted once from the camera and once from behind the vehicle."""


def one_pass(toy, camera, body):
    """Both clouds in one composite, over the sky."""
    view = View.from_camera(camera)
    vehicle_view = View.from_camera(camera, toy.insertion.trajectory.at(camera.time))
    records = [project(body, vehicle_view), project(Splats.from_gaussians(toy.background.gaussians), view)]
    rendering = composite(records, view)
    sky = torch.from_numpy(sky_image(toy.background.sky, camera))
    return rendering.rgb + (1 - rendering.alpha)[..., None] * sky, rendering.depth, rendering.alpha


def layered(toy, camera, body, slack=0.0):
    world_from_vehicle = toy.insertion.trajectory.at(camera.time)
    view = View.from_camera(camera, world_from_vehicle)
    bounds = np.stack([-toy.insertion.size / 2, toy.insertion.size / 2])
    interval = depth_interval(camera.camera_from_world @ world_from_vehicle, bounds, slack)
    frozen = FrozenBackground(toy.background, []).freeze(camera, "front", interval)
    rendering = frozen.render(body, view, threads=1)
    return (rendering.rgb, rendering.depth, rendering.alpha), frozen


@pytest.mark.parametrize("index", [0, 5, 11])
def test_layered_render_equals_one_pass(toy, index):
    body = Splats.from_gaussians(toy.truth)
    expected = one_pass(toy, toy.cameras[index], body)
    actual, frozen = layered(toy, toy.cameras[index], body)
    assert 0 < len(frozen.between) < len(toy.background.gaussians)
    scale = (1, 30, 1)  # depths reach 30 m
    for a, b, s in zip(actual, expected, scale, strict=True):
        assert (a - b).abs().max() < TOLERANCE * s


def test_layered_render_of_a_crop_equals_the_crop_of_one_pass(toy):
    body = Splats.from_gaussians(toy.truth)
    whole, _, _ = one_pass(toy, toy.cameras[5], body)
    (crop, _, _), _ = layered(toy, toy.cameras[5].crop(20, 18, 40, 30), body)
    assert (crop - whole[18:48, 20:60]).abs().max() < TOLERANCE


@pytest.mark.parametrize("index", [0, 5, 11])
@pytest.mark.parametrize(("ground_opacity", "tolerance"), [(0.1, 1e-5), (1.0, 1e-3)])
def test_layered_gradients_equal_those_of_one_pass(toy, index, ground_opacity, tolerance):
    # translucent: where light runs out, the rule that stops there would be compared, not the layers
    ground = toy.background.gaussians
    ground = replace(ground, opacities=ground.opacities * np.float32(ground_opacity))
    toy = replace(toy, background=replace(toy.background, gaussians=ground))
    weight = torch.from_numpy(np.random.default_rng(0).normal(size=(64, 96, 3)).astype(np.float32))
    gradients = []
    for render in (one_pass, lambda *a: layered(*a)[0]):
        truth = Splats.from_gaussians(toy.truth)
        leaves = [t.clone().requires_grad_() for t in (truth.means, truth.scales, truth.opacities / 10, truth.sh)]
        body = Splats(leaves[0], truth.quats, *leaves[1:])
        (render(toy, toy.cameras[index], body)[0] * weight).sum().backward()
        gradients.append([leaf.grad for leaf in leaves])
    for a, b in zip(*gradients, strict=True):
        assert (a - b).norm() < tolerance * b.norm()


def test_a_wider_interval_changes_nothing(toy):
    body = Splats.from_gaussians(toy.truth)
    (narrow, _, _), a = layered(toy, toy.cameras[5], body)
    (wide, _, _), b = layered(toy, toy.cameras[5], body, slack=3.0)
    assert len(b.between) > len(a.between)
    assert (narrow - wide).abs().max() < TOLERANCE


def test_threads_freeze_the_same_layers(toy):
    from concurrent.futures import ThreadPoolExecutor

    frozen = FrozenBackground(toy.background, [])

    def freeze(camera):
        return frozen.freeze(camera, "front", (8.0, 11.0)).layers

    alone = [freeze(camera) for camera in toy.cameras]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(freeze, toy.cameras))
    for a, b in zip(alone, together, strict=True):
        assert torch.equal(a.front_rgb, b.front_rgb)
        assert torch.equal(a.back_rgb, b.back_rgb)


def test_exposure_is_the_gain_of_the_view(toy):
    gains = {"front": np.float32([0.5, 1, 2])}
    background = Background(toy.background.gaussians, toy.background.sky, gains)
    frozen = FrozenBackground(background, [])
    assert frozen.freeze(toy.cameras[0], "front", (8.0, 9.0)).gain.tolist() == [0.5, 1, 2]
    assert frozen.freeze(toy.cameras[0], "rear", (8.0, 9.0)).gain.tolist() == [1, 1, 1]


def test_refined_poses_are_used_and_carried_to_frames_without(toy):
    frames = toy.scene().frames["front"]
    bend = pose(yaw_rotation(0.01), [0, 0.02, 0])
    known = {("front", i): frames[i].camera.world_from_camera @ bend for i in (0, 4)}
    background = replace(toy.background, poses=known)
    frozen = FrozenBackground(background, frames)
    for i in (0, 2, 4, 11):
        expected = frames[i].camera.world_from_camera @ bend
        np.testing.assert_allclose(frozen.camera(frames[i]).world_from_camera, expected, atol=1e-9)
    assert FrozenBackground(toy.background, frames).camera(frames[2]) is frames[2].camera


def test_the_fingerprint_sees_every_array(toy):
    background = toy.background
    assert fingerprint(background) == fingerprint(background)
    for field in ("means", "quats", "scales", "opacities", "sh"):
        changed = getattr(background.gaussians, field).copy()
        changed[0] += 0.001
        other = replace(background, gaussians=replace(background.gaussians, **{field: changed}))
        assert fingerprint(other) != fingerprint(background)
    assert fingerprint(replace(background, sky=background.sky + np.float32(0.01))) != fingerprint(background)
