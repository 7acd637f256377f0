"""The ground is found under traffic, beside walls and where no point fell."""

import numpy as np
import pytest

from dwgs.scene import InputError, LidarSweep, Trajectory
from dwgs.scene.ground import Ground
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import pose, yaw_rotation

EGO = Trajectory(
    np.linspace(0, 2, 21),
    pose(np.broadcast_to(np.eye(3), (21, 3, 3)), np.linspace([0, 0, 7], [20, 0, 7], 21)),
)


def true_height(xy: np.ndarray) -> np.ndarray:
    """A slope of 3 %, cambered, with a crest."""
    x, y = np.moveaxis(xy, -1, 0)
    return 5 + 0.03 * x - 0.02 * abs(y) + 0.2 * np.cos(x / 15)


def world(rng, count: int = 30000) -> tuple[np.ndarray, np.ndarray]:
    """Points and labels: ground, the roofs and sides of two cars, a wall at y = 9, noise below the ground."""
    xy = rng.uniform((-40, -15), (60, 9), (count, 2))
    ground = np.column_stack([xy, true_height(xy) + rng.normal(0, 0.015, count)])
    is_under_car = (abs(xy[:, 0] - 12) < 2.3) & (abs(abs(xy[:, 1]) - 3) < 0.95)
    ground[is_under_car, 2] += rng.uniform(0.3, 1.5, is_under_car.sum())
    wall = np.column_stack([rng.uniform(-40, 60, count // 3), np.full(count // 3, 9.0), rng.uniform(5, 15, count // 3)])
    labels = np.where(is_under_car, SURFACES.index("vehicle"), SURFACES.index("ground"))
    return np.concatenate([ground, wall]), np.append(labels, np.full(len(wall), SURFACES.index("static")))


def sweeps(count: int = 5, has_labels: bool = True) -> list[LidarSweep]:
    rng = np.random.default_rng(0)
    made = []
    for i in range(count):
        points, labels = world(rng)
        made.append(
            LidarSweep(
                points=points.astype(np.float32),
                times=np.full(len(points), i / 10),
                origin=np.array([0.0, 0, 2]),
                time=i / 10,
                frame_index=i,
                labels=labels.astype(np.uint8) if has_labels else None,
            )
        )
    return made


@pytest.mark.parametrize("has_labels", [True, False])
def test_height_is_found_on_the_road_and_under_cars(has_labels):
    ground = Ground.from_sweeps(sweeps(has_labels=has_labels), EGO)
    xy = np.stack(np.meshgrid(np.arange(-20, 40, 0.7), np.arange(-6, 6, 0.7)), -1)
    error = abs(ground.height(xy) - true_height(xy))
    assert np.median(error) < (0.01 if has_labels else 0.03)
    assert error.max() < 0.15
    assert abs(ground.height([12.0, 3.0]) - true_height(np.array([12.0, 3.0]))) < 0.1


def test_normals_stand_on_the_slope():
    ground = Ground.from_sweeps(sweeps(), EGO)
    x = 20.0
    slope = np.array([0.03 - 0.2 / 15 * np.sin(x / 15), -0.02])
    expected = np.append(-slope, 1) / np.linalg.norm([*slope, 1])
    mean = np.mean([ground.normal([x + dx, y]) for dx in (-1, 0, 1) for y in (4, 5, 6)], 0)
    assert np.degrees(np.arccos(mean @ expected / np.linalg.norm(mean))) < 0.5
    assert ground.normal(np.zeros((3, 2, 2))).shape == (3, 2, 3)


def test_where_no_point_fell_the_surroundings_go_on():
    """A hole of 10 x 6 m in the road, and 60 m past the last point."""
    made = sweeps()
    kept = [~((abs(s.points[:, 0] - 10) < 5) & (abs(s.points[:, 1]) < 3)) for s in made]
    ground = Ground.from_sweeps(
        [
            LidarSweep(s.points[k], s.times[k], s.origin, s.time, 0, s.labels[k])
            for s, k in zip(made, kept, strict=True)
        ],
        EGO,
    )
    hole = np.stack(np.meshgrid(np.linspace(6, 14, 9), np.linspace(-2, 2, 5)), -1)
    assert abs(ground.height(hole) - true_height(hole)).max() < 0.1
    far = ground.height(np.array([[120.0, 0], [-110.0, 0]]))
    assert abs(far - (5 + 0.03 * np.array([120, -110]))).max() < 1


def test_a_few_sweeps_tell_as_much_as_many_and_the_same_every_time():
    many = sweeps(17)
    one, two = Ground.from_sweeps(many, EGO), Ground.from_sweeps(many, EGO)
    np.testing.assert_array_equal(one.relief, two.relief)


def test_a_scene_turned_has_its_ground_turned():
    angle = 0.7
    turn = yaw_rotation(angle)
    turned = [
        LidarSweep((s.points @ turn.T).astype(np.float32), s.times, s.origin, s.time, 0, s.labels) for s in sweeps()
    ]
    ground = Ground.from_sweeps(turned, EGO.moved(pose(turn, np.zeros(3))))
    xy = np.stack(np.meshgrid(np.arange(-10, 30, 1.3), np.arange(-5, 5, 1.3)), -1)
    assert abs(ground.height(xy @ turn[:2, :2].T) - true_height(xy)).max() < 0.1


def test_without_lidar_there_is_no_ground():
    with pytest.raises(InputError, match="found in LiDAR points near the ego path"):
        Ground.from_sweeps([], EGO)
    far = [LidarSweep(s.points + 1000, s.times, s.origin, s.time, 0, s.labels) for s in sweeps(1)]
    with pytest.raises(InputError, match="found in LiDAR points near the ego path"):
        Ground.from_sweeps(far, EGO)
