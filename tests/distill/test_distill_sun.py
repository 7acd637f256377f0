"""The sun is found by the shadow that a box casts on grey ground, seen from above at a kerb."""

import numpy as np
import pytest
import torch

from dwgs.distill.config import GENERATED
from dwgs.distill.layers import FrozenView
from dwgs.distill.model import Vehicle, vehicle_bounds
from dwgs.distill.region import Region, Window
from dwgs.distill.shots import Shot, Sight
from dwgs.distill.sun import find_casting, resting_pose, turning
from dwgs.scene import Camera, Casting, Frame, Gaussians, Insertion, Trajectory, VehiclePoints
from dwgs.scene.pose import inverse, pose, transform_points, yaw_rotation
from dwgs.splat import Layers, Projected, View

SIZE = np.array([4.0, 1.8, 1.5])
MARGIN = 2.5
WIDTH, HEIGHT = 160, 120
GREY = 0.6


def sun_at(azimuth, slope):
    """[3] towards a sun whose shadows reach ``slope`` metres per metre."""
    direction = np.array([-slope * np.cos(azimuth), -slope * np.sin(azimuth), 1.0])
    return direction / np.linalg.norm(direction)


def camera():
    down = pose(np.array([[0, -0.6, 0.8], [-1, 0, 0], [0, -0.8, -0.6]]), [-7.0, 0, 6.0])
    return Camera(np.array([[110.0, 0, WIDTH / 2], [0, 110, HEIGHT / 2], [0, 0, 1]]), WIDTH, HEIGHT, down, 0.0)


def ground_points(eye):
    """[H, W, 3] where the rays of a camera meet the ground."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(eye.K).T @ eye.world_from_camera[:3, :3].T
    origin = eye.world_from_camera[:3, 3]
    return origin - rays * (origin[2] / rays[..., 2:])


def is_shaded(places, world_from_vehicle, sun):
    """Whether the way to the sun from places [..., 3] leads through the vehicle's box."""
    vehicle_from_world = inverse(world_from_vehicle)
    start = transform_points(vehicle_from_world, places.reshape(-1, 3))
    way = vehicle_from_world[:3, :3] @ sun
    near, far = np.sort(np.stack([(-SIZE / 2 - start) / way, (SIZE / 2 - start) / way]), axis=0)
    return (near.max(1) <= far.min(1)).reshape(places.shape[:-1])


def shot_of(world_from_vehicle, sun):
    eye = camera()
    shaded = is_shaded(ground_points(eye), world_from_vehicle, sun) if sun is not None else np.zeros((HEIGHT, WIDTH))
    target = torch.tensor(np.where(shaded, 0.25, GREY)[..., None].repeat(3, 2), dtype=torch.float32)
    one = torch.ones(HEIGHT, WIDTH)
    layers = Layers.of(None, (torch.full((HEIGHT, WIDTH, 3), GREY), one, one))
    frozen = FrozenView(layers, Projected(torch.zeros(0, 16)), torch.ones(3))
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    region = Region(Window(0, 0, WIDTH, HEIGHT), everywhere, ~everywhere, everywhere)
    frame = Frame(0, "front", eye, lambda: np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    sight = Sight(frame, eye, eye, world_from_vehicle, region, held_out=False)
    view = View.from_camera(eye, world_from_vehicle)
    return Shot(sight, view, frozen, frame.pixels, target, one, None)


@pytest.fixture(scope="module")
def insertion():
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (3000, 3)) * SIZE
    cloud = VehiclePoints(np.float32(points), np.full((3000, 3), 128, np.uint8), None, is_complete=True)
    return Insertion(cloud, SIZE, Trajectory(np.arange(2.0), np.stack([np.eye(4)] * 2)))


@pytest.fixture(scope="module")
def shadow():
    grid = np.stack(np.meshgrid(np.arange(-4, 4, 0.2), np.arange(-3, 3, 0.2)), -1).reshape(-1, 2)
    means = np.column_stack([grid, np.full(len(grid), -SIZE[2] / 2)]).astype(np.float32)
    n = len(means)
    return Gaussians(
        means,
        np.tile(np.float32([1, 0, 0, 0]), (n, 1)),
        np.full((n, 3), 0.05, np.float32),
        np.full(n, 0.5, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )


@pytest.mark.parametrize(("azimuth", "slope"), [(1.2, 0.9), (2.6, 0.6), (-1.8, 1.2)])
def test_the_sun_is_found_whatever_way_the_vehicle_faces(insertion, shadow, azimuth, slope):
    sun = sun_at(azimuth, slope)
    stands = [pose(yaw_rotation(0.4 + 0.01 * k), [0.1 * k, 0, 0.75]) for k in range(4)]
    casting = find_casting([shot_of(stand, sun) for stand in stands], insertion, shadow, MARGIN)
    assert casting is not None
    assert np.degrees(np.arccos(casting.sun @ sun)) < 8
    np.testing.assert_allclose(casting.slope_at(resting_pose([shot_of(s, None).sight for s in stands])), 0, atol=1e-9)


def test_the_farther_out_a_shadow_lies_the_higher_it_is_cast_from(insertion, shadow):
    sun = sun_at(np.pi / 2, 1.2)
    casting = find_casting([shot_of(pose(np.eye(3), [0, 0, 0.75]), sun)], insertion, shadow, MARGIN)
    assert casting is not None
    means = shadow.means[np.abs(shadow.means[:, 0]) < 1]
    heights = casting.heights[np.abs(shadow.means[:, 0]) < 1]
    rim, foot = np.abs(means[:, 1] - 2.5) < 0.2, np.abs(means[:, 1] + 0.8) < 0.2
    assert heights[rim].mean() > 1.1
    assert heights[foot].mean() < 0.3


def test_under_an_overcast_sky_there_is_no_sun(insertion, shadow):
    assert find_casting([shot_of(pose(np.eye(3), [0, 0, 0.75]), None)], insertion, shadow, MARGIN) is None


def test_what_is_dark_around_the_tyres_is_no_shadow_of_the_sun(insertion, shadow):
    stand = pose(np.eye(3), [0, 0, 0.75])
    shot = shot_of(stand, None)
    places = transform_points(inverse(stand), ground_points(camera()).reshape(-1, 3))
    dim = (np.abs(places[:, :2]) < SIZE[:2] / 2 + 0.25).all(1).reshape(HEIGHT, WIDTH)
    shot.target[torch.from_numpy(dim)] = 0.2
    assert find_casting([shot], insertion, shadow, MARGIN) is None


def test_without_a_shadow_there_is_no_sun(insertion):
    shots = [shot_of(pose(np.eye(3), [0, 0, 0.75]), sun_at(0.5, 1.0))]
    assert find_casting(shots, insertion, Gaussians.empty(), MARGIN) is None


def test_the_layers_leave_room_for_a_shadow_that_moves(shadow):
    sights = [shot_of(pose(yaw_rotation(turn), [0, 0, 0.75]), None).sight for turn in (0.0, 0.0, 0.3)]
    reach = turning(sights)
    assert reach == pytest.approx(2 * np.sin(0.15))
    still, moving = (vehicle_bounds(SIZE, shadow, r) for r in (0.0, MARGIN * reach))
    np.testing.assert_allclose(np.abs(moving - still), np.tile([MARGIN * reach, MARGIN * reach, 0], (2, 1)))


def test_a_shadow_lies_where_it_is_cast_until_the_next_step(shadow):
    sun = sun_at(0.5, 1.0)
    heights = np.linspace(0, 1.5, len(shadow), dtype=np.float32)
    vehicle = Vehicle(Gaussians.empty(), shadow, SIZE, GENERATED, Casting(sun, sun, heights))
    means = vehicle.splats().means
    before = means.detach().clone()
    for turn in (0.5, -0.2, -0.2):
        stand = pose(yaw_rotation(turn), np.zeros(3))
        vehicle.stand(stand)
        slope = sun[:2] / sun[2] - (stand[:3, :3].T @ sun)[:2] / sun[2]
        expected = heights[:, None] * slope
        np.testing.assert_allclose((means.detach() - before)[:, :2].numpy(), expected, atol=1e-5)
    vehicle.splats().means.grad = torch.zeros_like(means)
    vehicle.step(1.0, is_averaged=False)
    torch.testing.assert_close(vehicle.splats().means.detach(), before)


STANDS = [pose(yaw_rotation(turn), np.zeros(3)) for turn in (-0.2, -0.1, 0, 0.1, 0.2)]


def turning_vehicle(shadow):
    """Twenty Gaussians and a shadow in the sun."""
    sun = sun_at(0.5, 1.0)
    return Vehicle(shadow[:20], shadow, SIZE, GENERATED, Casting(sun, sun, np.ones(len(shadow), np.float32)))


def teach(vehicle, steps):
    """The first coefficient shall be 0.2 at rest, and 1.5 more per slope along y."""
    sun = sun_at(0.5, 1.0)
    for step in steps:
        stand = STANDS[step % len(STANDS)]
        vehicle.stand(stand)
        sh = vehicle.splats().sh
        sh.grad = torch.zeros_like(sh)
        slope = sun[:2] / sun[2] - (stand[:3, :3].T @ sun)[:2] / sun[2]
        sh.grad[:20, 0] = sh.detach()[:20, 0] - 0.2 - 1.5 * slope[1]
        vehicle.step(1.0 if step < 400 else 0.1, is_averaged=step >= 550)


def test_a_body_learns_how_its_colours_follow_the_sun(shadow):
    vehicle = turning_vehicle(shadow)
    teach(vehicle, range(600))
    learnt, _, casting, shading = vehicle.finish()
    for stand in STANDS:
        slope = casting.slope_at(stand)
        assert (shading.slopes[0] <= slope).all()
        assert (slope <= shading.slopes[1]).all()
        np.testing.assert_allclose(learnt.sh[:, 0] + shading.at(slope), 0.2 + 1.5 * slope[1], atol=0.02)


@pytest.mark.parametrize("stop", [3, 560])
def test_an_interrupted_vehicle_in_the_sun_goes_on_to_the_same_bytes(shadow, tmp_path, stop):
    whole, half, other = (turning_vehicle(shadow) for _ in range(3))
    teach(whole, range(600))
    teach(half, range(stop))
    torch.save(half.state_dict(), tmp_path / "half.pt")
    other.load_state_dict(torch.load(tmp_path / "half.pt", weights_only=True))
    teach(other, range(stop, 600))
    expected, resumed = whole.finish(), other.finish()
    np.testing.assert_array_equal(resumed[0].sh, expected[0].sh)
    np.testing.assert_array_equal(resumed[3].by_slope, expected[3].by_slope)
    np.testing.assert_array_equal(resumed[3].slopes, expected[3].slopes)
