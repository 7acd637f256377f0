import numpy as np
import pytest
import torch
from toy_street import SIZE

from dwgs.distill.lidar import LidarDepths, carried_depths, static_depths
from dwgs.distill.region import find_region
from dwgs.scene import LidarSweep
from dwgs.scene.pose import transform_points
from dwgs.splat import Drawing


def sweep_of(points, times=None, time=0.5):
    points = np.asarray(points, np.float32)
    times = np.full(len(points), time) if times is None else np.asarray(times, float)
    return LidarSweep(points, times, np.zeros(3), time, 5)


def at_pixel(camera, column, row, depth):
    ray = np.linalg.inv(camera.K) @ [column + 0.5, row + 0.5, 1]
    return transform_points(camera.world_from_camera, depth * ray[None])[0]


@pytest.fixture
def sight(toy):
    frame = toy.frame(5)
    pose = toy.insertion.trajectory.at(frame.camera.time)
    return frame, pose, find_region(frame, frame.camera, pose, toy.insertion, ())


def test_static_returns_count_in_the_rim_alone(sight):
    frame, _, region = sight
    inside = np.argwhere(region.reactive)[0] + [region.window.y, region.window.x]
    rim = np.argwhere(region.supervised & ~region.reactive)[0] + [region.window.y, region.window.x]
    points = [at_pixel(frame.camera, column, row, 9.0) for row, column in (inside, rim)]
    depths = static_depths(sweep_of(points), frame.camera, region)
    assert depths is not None
    row, column = rim - [region.window.y, region.window.x]
    assert (depths.rows.tolist(), depths.columns.tolist()) == ([row], [column])
    assert depths.depths.tolist() == pytest.approx([9.0])
    assert static_depths(sweep_of(points[:1]), frame.camera, region) is None


def test_the_nearest_return_of_a_pixel_counts(sight):
    frame, _, region = sight
    row, column = np.argwhere(region.supervised & ~region.reactive)[0] + [region.window.y, region.window.x]
    points = [at_pixel(frame.camera, column, row, depth) for depth in (9.0, 7.0, 8.0)]
    depths = static_depths(sweep_of(points), frame.camera, region)
    assert depths is not None
    assert depths.depths.tolist() == pytest.approx([7.0])


def test_returns_on_a_recorded_car_drive_with_it_to_the_cameras_time(toy):
    frame = toy.frame(5, is_generated=False)
    trajectory = toy.insertion.trajectory
    world_from_vehicle = trajectory.at(frame.camera.time)
    region = find_region(frame, frame.camera, world_from_vehicle, toy.insertion, ())
    assert region is not None
    on_car = np.array([[0, -0.9, 0]])
    hit = transform_points(trajectory.at(0.42), on_car)
    street = [20.0, 0, 0]
    sweep = sweep_of([hit[0], street], [0.42, 0.42])
    depths = carried_depths(sweep, frame.camera, world_from_vehicle, toy.insertion, region)
    assert depths is not None
    expected = frame.camera.project(transform_points(world_from_vehicle, on_car))[1]
    assert depths.depths.tolist() == pytest.approx(expected.tolist(), rel=1e-5)
    assert (np.abs(on_car) <= SIZE / 2).all()


def drawing(depth, alpha) -> Drawing:
    return Drawing(*(torch.zeros(2, 2, 3), depth, alpha), *(torch.zeros(2, 2, 3), torch.zeros(2, 2), torch.zeros(2, 2)))


@pytest.mark.parametrize(("is_bound", "error"), [(False, 0.3125), (True, 0.1875)])
def test_the_error_is_relative_and_one_sided_before_the_street(is_bound, error):
    lidar = LidarDepths(torch.tensor([0, 1]), torch.tensor([0, 1]), torch.tensor([16.0, 8.0]), is_bound)
    drawn = drawing(torch.full((2, 2), 5.0), torch.full((2, 2), 0.5))
    assert lidar.pull(drawn, 3.0) == pytest.approx(3 * error)


@pytest.mark.parametrize("is_bound", [False, True])
def test_the_gradient_is_that_of_the_error(is_bound):
    random = torch.Generator().manual_seed(0)
    depth, alpha = (torch.rand(2, 2, generator=random, dtype=torch.float64) for _ in range(2))
    rows, columns = torch.tensor([0, 0, 1, 1]), torch.tensor([0, 1, 0, 1])
    measured = depth / alpha * torch.tensor([[0.7, 1.2], [1.4, 9.0]], dtype=torch.float64)  # the last is out of reach
    lidar = LidarDepths(rows, columns, measured.flatten(), is_bound)
    drawn = drawing(depth, alpha)
    lidar.pull(drawn, 2.0)
    for image, gradient in ((depth, drawn.v_depth), (alpha, drawn.v_alpha)):
        for pixel in range(4):
            errors = []
            for change in (1e-6, -1e-6):
                image.view(-1)[pixel] += change
                errors.append(lidar.pull(drawing(depth, alpha), 2.0))
                image.view(-1)[pixel] -= change
            assert gradient.view(-1)[pixel].item() == pytest.approx((errors[0] - errors[1]) / 2e-6, abs=1e-6)
    assert drawn.v_depth.abs().sum() > 0
