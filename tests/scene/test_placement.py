"""An inserted vehicle drives the ego's path with its wheels on the ground."""

import numpy as np
import pytest

from dwgs.scene import Camera, Frame, InputError, LidarSweep, Scene, Track, Trajectory
from dwgs.scene.ground import Ground
from dwgs.scene.insertion import box_corners
from dwgs.scene.placement import conflicts, place_ahead, stand_on
from dwgs.scene.pose import pose, transform_points, yaw_rotation

SIZE = np.array([4.5, 1.8, 1.5])
TIMES = np.arange(0, 3, 0.1)


def flat_ground(slope_x: float = 0.0, slope_y: float = 0.0) -> Ground:
    return Ground(np.array([slope_x, slope_y, 1.0]), np.zeros(2), np.zeros((2, 2)))


def drive(x: np.ndarray, times: np.ndarray = TIMES) -> Trajectory:
    positions = np.stack([x, np.zeros_like(x), np.full_like(x, 1.5)], 1)
    return Trajectory(times, pose(np.broadcast_to(np.eye(3), (len(x), 3, 3)), positions))


def scene_of(ego: Trajectory, tracks: tuple[Track, ...] = (), slope: float = 0.0) -> Scene:
    rng = np.random.default_rng(0)
    xy = rng.uniform((-40, -20), (100, 20), (40000, 2))
    points = np.column_stack([xy, 1 + slope * xy[:, 0]]).astype(np.float32)
    sweep = LidarSweep(points, np.zeros(len(points)), np.zeros(3), 0.0, 0, np.ones(len(points), np.uint8))
    K = np.array([[50.0, 0, 4], [0, 50, 4], [0, 0, 1]])
    frames = {
        name: tuple(
            Frame(
                10 + i,
                name,
                Camera(K, 8, 8, np.eye(4), float(t) + lag),
                lambda: np.zeros((8, 8, 3), np.uint8),
            )
            for i, t in enumerate(TIMES)
        )
        for name, lag in (("front", 0.0), ("left", -0.013))
    }
    return Scene("drive", frames, ego, (sweep,), tracks)


def test_it_starts_where_it_is_told_and_keeps_the_pace_of_the_ego():
    ego = drive(4 * TIMES + TIMES**2)
    placed = place_ahead(scene_of(ego), SIZE, ahead=12, left=3.2, speed=None)
    gap = placed.at(TIMES)[:, :3, 3] - ego.at(TIMES)[:, :3, 3]
    np.testing.assert_allclose(gap[:, :2], np.broadcast_to((12, 3.2), (30, 2)), atol=0.01)


def test_it_drives_at_the_speed_it_is_told_past_the_end_of_the_path():
    placed = place_ahead(scene_of(drive(2 * TIMES)), SIZE, ahead=5, left=-2, speed=20)
    x = placed.at(TIMES)[:, 0, 3]
    np.testing.assert_allclose(np.diff(x), 2, atol=1e-6)
    assert x[0] == pytest.approx(5, abs=0.3)  # 13 ms after the first frame of the other camera
    np.testing.assert_allclose(placed.at(TIMES)[:, 1, 3], -2, atol=1e-6)


def test_it_covers_the_time_of_every_frame_exactly():
    scene = scene_of(drive(2 * TIMES))
    placed = place_ahead(scene, SIZE, 10, 0, None)
    times = np.unique([frame.camera.time for frame in scene.all_frames()])
    np.testing.assert_array_equal(placed.times, times)


def test_behind_a_standing_ego_it_stands_without_a_tremor():
    rng = np.random.default_rng(0)
    ego = drive(rng.normal(0, 0.005, len(TIMES)))
    placed = place_ahead(scene_of(ego), SIZE, ahead=-8, left=0, speed=None)
    assert np.ptp(placed.world_from_vehicle[:, :3, 3], axis=0).max() < 0.02
    assert abs(placed.world_from_vehicle[:, :3, :3] - placed.world_from_vehicle[0, :3, :3]).max() < 1e-3


@pytest.mark.parametrize("slopes", [(0, 0), (0.1, 0), (0, -0.08), (0.06, 0.05)])
def test_the_corners_of_its_floor_touch_the_slope(slopes):
    ground = flat_ground(*slopes)
    world_from_vehicle = stand_on(ground, np.array([[3.0, 4], [10, -2]]), np.array([0.3, 2.0]), SIZE)
    floor = box_corners(SIZE)[[0, 2, 4, 6]]
    for one in world_from_vehicle:
        corners = transform_points(one, floor)
        np.testing.assert_allclose(corners[:, 2], ground.height(corners[:, :2]), atol=1e-9)
        np.testing.assert_allclose(one[:3, 2], ground.normal(np.zeros(2)), atol=1e-9)


def test_heading_is_kept_on_a_slope():
    heading = np.array([0.3, 2.0, -1.0])
    x_axis = stand_on(flat_ground(0.1, 0.1), np.zeros((3, 2)), heading, SIZE)[:, :2, 0]
    np.testing.assert_allclose(np.arctan2(x_axis[:, 1], x_axis[:, 0]), heading, atol=1e-9)


def test_wheels_stand_on_the_ground_of_the_lidar():
    placed = place_ahead(scene_of(drive(4 * TIMES), slope=0.05), SIZE, 20, 2, 5)
    bottom = transform_points(placed.world_from_vehicle[3], [[0, 0, -SIZE[2] / 2]])[0]
    assert bottom[2] == pytest.approx(1 + 0.05 * bottom[0], abs=0.01)


def test_without_lidar_nothing_can_be_placed():
    scene = scene_of(drive(4 * TIMES))
    with pytest.raises(InputError, match="found in LiDAR"):
        place_ahead(Scene("bare", scene.frames, scene.ego), SIZE, 10, 0, None)


def box_at(x, y: float, yaw: float = 0.0) -> Trajectory:
    x = np.broadcast_to(x, TIMES.shape)
    return Trajectory(TIMES, pose(yaw_rotation(np.full(len(x), yaw)), np.stack([x, np.full_like(x, y), 0 * x], 1)))


def test_conflicts_name_who_is_hit_and_when():
    tracks = (
        Track("oncoming", "Car", np.array([4.0, 2, 1.5]), box_at(30 - 10 * TIMES, 0), True),
        Track("beside", "Car", np.array([4.0, 2, 1.5]), box_at(10.0, 2.5), False),
        Track("earlier", "Car", SIZE, Trajectory(TIMES[:3] - 5, box_at(10.0, 0).world_from_vehicle[:3]), True),
    )
    scene = scene_of(drive(2 * TIMES), tracks)
    assert conflicts(scene, SIZE, box_at(10.0, 0)) == [("oncoming", 26, 34)]
    # |30 - 10 t - 10| < (4 + 4.5) / 2 from 1.6 s to 2.4 s, and frames count from 10


def test_a_turned_box_beside_another_is_seen_to_miss_it():
    other = Track("other", "Car", np.array([4.0, 2, 1.5]), box_at(0.0, 0.0, yaw=np.pi / 4), False)
    scene = scene_of(drive(2 * TIMES), (other,))
    assert not conflicts(scene, np.array([4.0, 2, 1.5]), box_at(2.6, -2.6, yaw=0.0))
    assert conflicts(scene, np.array([4.0, 2, 1.5]), box_at(2.6, 2.0, yaw=0.0))
