from dataclasses import replace

import numpy as np
import pytest
import torch
from toy_street import SIZE, cloud, paint, placed

from dwgs.distill import DistillConfig, FrozenBackground, distill, others
from dwgs.distill.config import GENERATED
from dwgs.distill.layers import depth_interval
from dwgs.distill.shots import find_sights
from dwgs.scene import Gaussians, Scene, Track, Trajectory, VehicleAsset
from dwgs.scene.pose import pose, yaw_rotation
from dwgs.splat import Splats, View

NEARER, AMONG, FARTHER = 5.0, 9.5, 15.0
"""Where other traffic is [m], before, beside and behind the vehicle of the toy street."""


def driven(toy, x, times=(0.0, 2.0)):
    """The toy's vehicle once more, on a way of its own across the street."""
    points = toy.truth.means
    shadow = cloud(points[:50] * [1.2, 1.2, 0] - [0, 0, 0.74], np.full((50, 3), 0.03), [0.1, 0.1, 0.01], 0.3)
    body = cloud(points, paint(points[:, ::-1]), [0.05, 0.05, 0.05])
    trajectory = Trajectory(
        np.array(times),
        pose(yaw_rotation(np.array([0.3, 0.5])), np.array([[x, -1.5, 0.75], [x, 1.5, 0.75]])),
    )
    return VehicleAsset(body, shadow, SIZE), trajectory


def with_standing(toy, traffic, time):
    """The toy street with the traffic of one time in its one cloud, turned into the world's frame."""
    clouds = [toy.background.gaussians]
    for asset, trajectory in traffic:
        # spheres may be turned; the shadow's discs are turned about their own axis of symmetry
        clouds.append(placed(asset.gaussians, trajectory.at(time)))
    return replace(toy, background=replace(toy.background, gaussians=Gaussians.concatenate(clouds)))


@pytest.fixture(scope="module")
def traffic(toy):
    return [driven(toy, x) for x in (NEARER, AMONG, FARTHER)]


@pytest.mark.parametrize("index", [0, 5, 11])
def test_frozen_traffic_is_drawn_where_it_is_at_the_time(toy, traffic, index):
    camera = toy.cameras[index]
    world_from_vehicle = toy.insertion.trajectory.at(camera.time)
    interval = depth_interval(camera.camera_from_world @ world_from_vehicle, np.stack([-SIZE / 2, SIZE / 2]), 0.0)
    view = FrozenBackground(toy.background, [], traffic).freeze(camera, "front", interval)
    rgb = view.render(Splats.from_gaussians(toy.truth), View.from_camera(camera, world_from_vehicle), threads=1).rgb
    truth = with_standing(toy, traffic, camera.time)
    assert np.abs(rgb.numpy() - truth.picture(camera)).max() < 2e-4
    assert np.abs(rgb.numpy() - toy.picture(camera)).max() > 0.2
    empty = FrozenBackground(toy.background, []).freeze(camera, "front", interval)
    assert len(view.between) > len(empty.between)
    assert (view.layers.front_rgb - empty.layers.front_rgb).abs().max() > 0.2
    assert (view.layers.back_rgb - empty.layers.back_rgb).abs().max() > 0.2


def test_traffic_is_there_only_while_its_trajectory_says_so(toy):
    gone = driven(toy, FARTHER, times=(5.0, 6.0))
    interval = (8.0, 11.0)
    layers = [
        FrozenBackground(toy.background, [], vehicles).freeze(toy.cameras[3], "front", interval).layers
        for vehicles in ([], [gone])
    ]
    assert torch.equal(layers[0].back_rgb, layers[1].back_rgb)


def test_traffic_that_is_frozen_teaches_and_other_traffic_does_not(toy):
    """Masks fall where a vehicle is explained, and only there and then."""
    vehicle = driven(toy, FARTHER)
    jitter = vehicle[1].moved(pose(np.eye(3), [0.2, 0.1, 0.0]))
    track = Track("other", "Car", SIZE, jitter, True)

    def taught(vehicles, tracks):
        frozen = FrozenBackground(toy.background, [], vehicles)
        sights = find_sights(toy.scene(tracks=tracks), frozen, toy.insertion, GENERATED, threads=1)
        return [int(sight.region.supervised.sum()) for sight in sights]

    empty = taught([], [])
    masked = taught([], [track])
    assert sum(masked) < sum(empty) - 100
    assert taught([vehicle], [track]) == empty
    half = vehicle[0], Trajectory(*(a[:1] for a in (vehicle[1].times, vehicle[1].world_from_vehicle)))  # only at 0 s
    assert taught([half], [track]) == empty[:1] + masked[1:]
    assert taught([driven(toy, AMONG)], [track]) == masked


def test_the_vehicle_itself_is_no_traffic(toy, traffic):
    nearer, _, farther = traffic
    itself = nearer[0], toy.insertion.trajectory.moved(pose(np.eye(3), [0.3, 0.2, 0.0]))
    assert others([nearer, itself, farther], toy.insertion) == [nearer, farther]


def test_a_vehicle_before_frozen_traffic_is_recovered_and_leaves_it_as_it_is(toy):
    vehicle = driven(toy, FARTHER)

    def frame(index):
        camera = toy.cameras[index]
        pixels = with_standing(toy, [vehicle], camera.time).picture(camera)
        return toy.frame(index, np.round(pixels.clip(0, 1) * 255).astype(np.uint8))

    frames = tuple(frame(i) for i in range(len(toy.cameras)))
    scene = Scene("toy", {"front": frames}, toy.insertion.trajectory, (), (Track("b", "Car", SIZE, vehicle[1], True),))
    config = DistillConfig(steps=100, gaussians=1500, shadow_margin=0.3, threads=1)

    frozen = FrozenBackground(toy.background, frames, [vehicle])
    before = frozen.fingerprint()
    loop = distill(scene, frozen, toy.insertion, config)
    while True:
        try:
            next(loop)
        except StopIteration as stop:
            report = stop.value.report
            break
    assert report["psnr_roi_heldout"] > 36
    assert report["background_unchanged"]
    assert frozen.fingerprint() == before


def test_the_fingerprint_sees_the_traffic(toy, traffic):
    prints = {FrozenBackground(toy.background, [], traffic[:n]).fingerprint() for n in range(3)}
    moved = [(traffic[0][0], traffic[0][1].moved(pose(np.eye(3), [0.01, 0, 0])))]
    assert len(prints | {FrozenBackground(toy.background, [], moved).fingerprint()}) == 4
