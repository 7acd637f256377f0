"""The backend that renders an asset into the frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from dwgs.scene import Camera, Frame, Gaussians, Insertion, LidarSweep, Scene, Trajectory, VehicleAsset, VehiclePoints
from dwgs.scene.pose import pose
from generator.asset import AssetGenerator
from generator.asset.gaussians import asset_of, contact_shadow
from generator.conditions.conditions import make_conditions

SIZE = np.array([4.0, 1.8, 1.4])
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
WIDTH, HEIGHT = 144, 96
ROAD, SKY, PAINT = (90, 90, 95), (200, 210, 230), (60, 160, 40)


def box_vehicle(color=PAINT, count=5000):
    rng = np.random.default_rng(0)
    points, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            face = rng.uniform(-0.5, 0.5, (count, 3))
            face[:, axis] = sign / 2
            points.append(face * SIZE)
            normals.append(np.tile(sign * np.eye(3)[axis], (count, 1)))
    points, normals = (np.concatenate(a).astype(np.float32) for a in (points, normals))
    return VehiclePoints(points, np.full(points.shape, color, np.uint8), normals, is_complete=True)


def drive(wall=False):
    """A road under a sky, two frames; a wall may stand before the right half."""
    K = np.array([[120.0, 0, WIDTH / 2], [0, 120, HEIGHT / 2], [0, 0, 1]])
    camera = Camera(K, WIDTH, HEIGHT, pose(FORWARD, [0, 0, 1.5]), 0.0)
    image = np.full((HEIGHT, WIDTH, 3), ROAD, np.uint8)
    image[: HEIGHT // 2] = SKY
    x, y = np.meshgrid(np.linspace(2, 40, 120), np.linspace(-10, 10, 60))
    cloud = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    if wall:
        y, z = np.meshgrid(np.linspace(-3, 0, 120), np.linspace(0.02, 3, 120))
        shaded = (cloud[:, 0] > 5) & (cloud[:, 1] < 0) & (cloud[:, 1] > -0.6 * cloud[:, 0])
        stones = np.column_stack([np.full(y.size, 5.0), y.ravel(), z.ravel()])
        cloud = np.concatenate([cloud[~shaded], stones])
        uv, _ = camera.project(stones)
        (left, top), (right, bottom) = np.floor(uv.min(0)).clip(0).astype(int), np.ceil(uv.max(0)).astype(int)
        image[top:bottom, left:right] = (30, 30, 120)
    frames, sweeps = [], []
    for i in range(2):
        frames.append(Frame(i, "front", replace(camera, time=0.1 * i), lambda: image.copy()))
        points = cloud.astype(np.float32)
        sweeps.append(LidarSweep(points, np.full(len(points), 0.1 * i), np.array([0, 0, 1.8]), 0.1 * i, i))
    ego = Trajectory(np.array([0.0, 0.1]), np.stack([np.eye(4)] * 2))
    return Scene("drive", {"front": tuple(frames)}, ego, tuple(sweeps))


def insertion(vehicle=None, size=SIZE):
    poses = np.stack([pose(np.eye(3), [12, 0, size[2] / 2])] * 2)
    return Insertion(vehicle or box_vehicle(), size, Trajectory(np.array([0.0, 0.1]), poses))


def generate(scene, what, asset=None):
    return AssetGenerator(asset).generate(make_conditions(scene, what), seed=0)


@pytest.fixture(scope="module")
def edited():
    scene = drive()
    return scene, generate(scene, insertion())


def test_the_vehicle_shows_the_colour_of_its_points_whatever_the_light(edited):
    _, result = edited
    pixels = result.frames["front"][0].pixels
    u, v = WIDTH // 2, HEIGHT // 2 + round(120 * (1.5 - SIZE[2] / 2) / 10)
    shown = pixels[v, u].astype(int)
    assert shown.argmax() == 1
    assert np.abs(shown / shown.sum() - np.array(PAINT) / sum(PAINT)).max() < 0.05


def test_the_road_beneath_it_is_darker(edited):
    scene, result = edited
    v = HEIGHT // 2 + round(120 * 1.5 / 9.9)
    before, after = (s.frames["front"][0].pixels[v, WIDTH // 2].astype(int) for s in (scene, result))
    assert after.sum() < 0.8 * before.sum()


def test_pixels_outside_the_reactive_mask_are_the_recordings_bit_for_bit(edited):
    scene, result = edited
    for before, after in zip(scene.frames["front"], result.frames["front"], strict=True):
        differs = (before.pixels != after.pixels).any(-1)
        assert differs.any()
        assert not (differs & ~after.reactive_mask).any()


def test_what_was_recorded_nearer_hides_it():
    scene = drive(wall=True)
    result = generate(scene, insertion())
    before, after = (s.frames["front"][0].pixels.astype(int) for s in (scene, result))
    differs = (abs(before - after) > 8).any(-1)
    is_wall = (before == (30, 30, 120)).all(-1)
    assert differs[~is_wall].sum() > 100
    assert not (differs & np.asarray(binary_erosion(is_wall, iterations=2))).any()


def test_the_same_seed_gives_the_same_bytes(edited):
    scene, result = edited
    again = generate(scene, insertion())
    for a, b in zip(result.frames["front"], again.frames["front"], strict=True):
        assert (a.pixels == b.pixels).all()


def test_a_given_asset_is_drawn_instead_and_stands_on_the_ground():
    low = SIZE * [1, 1, 0.5]
    scene, vehicle = drive(), box_vehicle((200, 20, 20))
    small = VehiclePoints(
        vehicle.points * np.float32([1, 1, 0.5]), vehicle.colors, vehicle.normals, vehicle.is_complete
    )
    asset = asset_of(small, low)
    given = VehicleAsset(asset.body, Gaussians.empty(), low)
    result = generate(scene, insertion(), given)
    pixels = result.frames["front"][0].pixels.astype(int)
    is_red = pixels[..., 0] > 2 * pixels[..., 1]
    rows = np.flatnonzero(is_red.any(1))
    top, bottom = (HEIGHT / 2 + 120 * (1.5 - z) / x for x, z in ((14, low[2]), (10, 0)))  # end of the roof, rear
    assert rows[0] == pytest.approx(top, abs=2)
    assert rows[-1] == pytest.approx(bottom, abs=2)


def test_gaussians_made_of_points_lie_flat_on_the_surface():
    body = asset_of(box_vehicle(), SIZE).body
    np.testing.assert_allclose(np.linalg.norm(body.quats, axis=1), 1, atol=1e-6)
    assert (np.abs(body.means) <= SIZE / 2 + 1e-4).all()
    w, x, y, z = body.quats.T
    normals = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], 1)
    face = np.abs(body.means / SIZE).argmax(1)
    outward = np.sign(body.means[np.arange(len(face)), face])
    np.testing.assert_allclose(normals[np.arange(len(face)), face], outward, atol=1e-3)
    assert (body.scales[:, 2] < body.scales[:, 0]).all()


def test_the_shadow_lies_on_the_ground_and_fades_beside_the_vehicle():
    shadow = contact_shadow(SIZE)
    assert np.allclose(shadow.means[:, 2], shadow.means[0, 2])
    assert -SIZE[2] / 2 <= shadow.means[0, 2] < 0.1 - SIZE[2] / 2
    beside = np.linalg.norm(np.maximum(np.abs(shadow.means[:, :2]) - SIZE[:2] / 2, 0), axis=1)
    order = np.argsort(beside)
    assert (np.diff(shadow.opacities[order]) <= 1e-6).all()
