from functools import cache

import numpy as np
import pytest

from dwgs.scene import Camera, Frame, Insertion, LidarSweep, Scene, Trajectory, VehiclePoints
from dwgs.scene.pose import pose
from generator.composite import CompositeGenerator
from generator.conditions.conditions import make_conditions

SIZE = np.array([4.0, 1.8, 1.4])
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
WIDTH, HEIGHT = 192, 128


def box_vehicle():
    rng = np.random.default_rng(0)
    points, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            face = rng.uniform(-0.5, 0.5, (6000, 3))
            face[:, axis] = sign / 2
            points.append(face * SIZE)
            normals.append(np.tile(sign * np.eye(3)[axis], (6000, 1)))
    points, normals = (np.concatenate(a).astype(np.float32) for a in (points, normals))
    return VehiclePoints(points, np.full(points.shape, 220, np.uint8), normals, is_complete=True)


def street(wall):
    """A grey road under a pale sky, three frames; a wall may hide the right half of the vehicle."""
    x, y = np.meshgrid(np.linspace(2, 40, 120), np.linspace(-10, 10, 60))
    cloud = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    image = np.full((HEIGHT, WIDTH, 3), (90, 90, 95), np.uint8)
    image[: HEIGHT // 2] = (200, 210, 230)
    camera = Camera(
        np.array([[160.0, 0, WIDTH / 2], [0, 160, HEIGHT / 2], [0, 0, 1]]),
        WIDTH,
        HEIGHT,
        pose(FORWARD, [0, 0, 1.5]),
        0.0,
    )
    if wall:
        y, z = np.meshgrid(np.linspace(-3, 0, 120), np.linspace(0.02, 3, 120))
        shaded = (cloud[:, 0] > 5) & (cloud[:, 1] < 0) & (cloud[:, 1] > -0.6 * cloud[:, 0])
        cloud = np.concatenate([cloud[~shaded], np.column_stack([np.full(y.size, 5.0), y.ravel(), z.ravel()])])
        uv, _ = camera.project(cloud[-y.size :])
        (left, top), (right, bottom) = np.floor(uv.min(0)).clip(0).astype(int), np.ceil(uv.max(0)).astype(int)
        image[top:bottom, left:right] = (30, 120, 30)
    image = np.clip(image + np.random.default_rng(1).normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    frames, sweeps = [], []
    for i in range(3):
        at = Camera(camera.K, WIDTH, HEIGHT, camera.world_from_camera, 0.1 * i)
        frames.append(Frame(i, "front", at, lambda: image.copy()))
        points = cloud.astype(np.float32)
        sweeps.append(LidarSweep(points, np.full(len(points), 0.1 * i), np.array([0, 0, 1.8]), 0.1 * i, i))
    ego = Trajectory(np.array([0.0, 0.2]), np.stack([np.eye(4)] * 2))
    return Scene("street", {"front": tuple(frames)}, ego, tuple(sweeps))


def insertion(vehicle, last_is_behind=False):
    poses = np.stack([pose(np.eye(3), [12, 0, SIZE[2] / 2])] * 3)
    if last_is_behind:
        poses[2, 0, 3] = -20
    return Insertion(vehicle, SIZE, Trajectory(np.array([0.0, 0.1, 0.2]), poses))


@cache
def edited(wall=False, last_is_behind=False, seed=0):
    scene = street(wall)
    conditions = make_conditions(scene, insertion(box_vehicle(), last_is_behind))
    return scene, CompositeGenerator().generate(conditions, seed)


def frames_of(pair):
    scene, result = pair
    return zip(scene.frames["front"], result.frames["front"], strict=True)


@pytest.mark.parametrize("wall", [False, True])
def test_pixels_outside_the_reactive_mask_are_the_recordings_bit_for_bit(wall):
    for before, after in frames_of(edited(wall)):
        mask = after.reactive_mask
        assert mask.any()
        assert (before.pixels[~mask] == after.pixels[~mask]).all()
        assert (before.pixels[mask] != after.pixels[mask]).any()


def test_the_same_seed_gives_the_same_bytes():
    again = CompositeGenerator().generate(make_conditions(street(False), insertion(box_vehicle())), 0)
    for first, second in zip(edited()[1].frames["front"], again.frames["front"], strict=True):
        assert first.pixels.tobytes() == second.pixels.tobytes()


def test_a_frame_that_does_not_see_the_vehicle_is_the_recordings():
    before, after = list(frames_of(edited(last_is_behind=True)))[2]
    assert not after.reactive_mask.any()
    assert (before.pixels == after.pixels).all()


def test_what_the_lidar_hit_nearer_hides_the_vehicle():
    before, after = next(frames_of(edited(wall=True)))
    is_wall = (before.pixels[..., 1] > 90) & (before.pixels[..., 0] < 60)
    unchanged = (before.pixels == after.pixels).all(-1)
    inside = is_wall & after.reactive_mask
    assert inside.sum() > 100
    assert unchanged[inside].mean() > 0.85  # its edge is as soft as any
    assert unchanged[~is_wall & after.reactive_mask].mean() < 0.6


def test_the_shadow_only_darkens_the_ground():
    before, after = next(frames_of(edited()))
    camera = before.camera
    roof, _ = camera.project([[10, 0, 0]])
    below = np.zeros(after.reactive_mask.shape, bool)
    below[int(roof[0, 1]) + 2 :] = True
    ground = after.reactive_mask & below
    change = after.pixels.astype(int) - before.pixels
    assert ground.any()
    assert (change[ground] <= 0).all()
    assert change[ground].min() < -5


def test_a_vehicle_that_stands_still_does_not_flicker():
    _, result = edited()
    first, second = (f.pixels.astype(float) for f in result.frames["front"][:2])
    assert np.abs(first - second).mean() < 1.0


def test_the_edited_scene_keeps_the_recordings_lidar_and_ego():
    scene, result = edited()
    assert result.sweeps is scene.sweeps
    assert result.ego is scene.ego
