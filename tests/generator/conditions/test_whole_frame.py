"""A red wall and a blue car that drives before it, hit by the LiDAR and seen by a camera; another car is put in."""

from dataclasses import replace

import numpy as np
import pytest
from toy_vehicle import LOOK_ALONG_X, SIZE, box_points, drive

from dwgs.scene import Camera, Frame, InputError, Insertion, LidarSweep, Scene, Track, Trajectory, VehiclePoints
from dwgs.scene.pose import pose, transform_points
from dwgs.scene.silhouette import box_silhouette
from generator.conditions import make_conditions
from generator.conditions.raster import GREY
from generator.conditions.whole_frame import StreetPoints, whole_frame

FRAMES = 3
RED, BLUE, GREEN = np.array([200, 0, 0]), np.array([0, 0, 200]), np.array([0, 200, 0])
CAR = drive(12.0, y=-3.0)


def camera(i: int) -> Camera:
    K = np.array([[100, 0, 80], [0, 100, 60], [0, 0, 1]], float)
    return Camera(K, 160, 120, pose(LOOK_ALONG_X, [0, 0, 1.5]), 0.1 * i)


def pixels(i: int) -> np.ndarray:
    car = box_silhouette(camera(i), CAR.at(0.1 * i), SIZE)
    return np.where(car[..., None], BLUE, RED).astype(np.uint8)


def sweep(i: int) -> LidarSweep:
    """Of a wall 30 m ahead and of the car's surface where it is just then."""
    rng = np.random.default_rng(i)
    wall = np.stack([np.full(6000, 30.0), rng.uniform(-20, 20, 6000), rng.uniform(-5, 15, 6000)], 1)
    points = np.concatenate([wall, transform_points(CAR.at(0.1 * i), box_points(SIZE, 1000).points)])
    return LidarSweep(points.astype(np.float32), np.full(len(points), 0.1 * i), np.zeros(3), 0.1 * i, i)


@pytest.fixture(scope="module")
def recorded() -> Scene:
    frames = tuple(Frame(i, "front", camera(i), lambda i=i: pixels(i)) for i in range(FRAMES))
    ego = Trajectory(np.arange(FRAMES) * 0.1, np.stack([np.eye(4)] * FRAMES))
    tracks = (Track("car", "Car", SIZE, CAR, True),)
    return Scene("wall", {"front": frames}, ego, tuple(map(sweep, range(FRAMES))), tracks)


@pytest.fixture(scope="module")
def conditions(recorded):
    vehicle = box_points(SIZE)
    green = VehiclePoints(vehicle.points, np.broadcast_to(GREEN, (4000, 3)).astype(np.uint8), vehicle.normals, True)
    return make_conditions(recorded, Insertion(green, SIZE, drive(12.0, y=3.0)))


@pytest.fixture(scope="module")
def whole(conditions):
    return whole_frame(conditions)


def share(image: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Pixels [H, W] that points of this colour and of no other have drawn on the canvas."""
    drawn = image.astype(float) - GREY
    toward = drawn @ (color - GREY) / np.linalg.norm(color - GREY) ** 2
    off = np.abs(drawn - toward[..., None] * (color - GREY)).max(-1)
    return (toward > 0.2) & (off < 3)


def rear(insertion: Insertion, i: int) -> np.ndarray:
    """Pixels [H, W] that see the rear side of the inserted box."""
    world_from_rear = insertion.trajectory.at(0.1 * i) @ pose(np.eye(3), [-SIZE[0] / 2, 0, 0])
    return box_silhouette(camera(i), world_from_rear, SIZE * [0.01, 1, 1], -1)


def test_every_pixel_may_be_painted_and_no_recorded_one_is_shown(whole):
    for frame in whole.frames["front"]:
        assert frame.load_reactive_mask().all()
        assert (frame.load_inactive_image() == GREY).all()


def test_street_traffic_and_vehicle_are_each_drawn_where_they_are(whole, conditions):
    inserted, image = conditions.insertion, whole.frames["front"][2].load_point_image()
    there = box_silhouette(camera(2), inserted.trajectory.at(0.2), SIZE)
    car = box_silhouette(camera(2), CAR.at(0.2), SIZE, 2)
    green, blue, red = (share(image, color) for color in (GREEN, BLUE, RED))
    assert green[rear(inserted, 2)].mean() > 0.8
    assert not green[~box_silhouette(camera(2), inserted.trajectory.at(0.2), SIZE, 2)].any()
    assert blue[car].mean() > 0.1
    assert not blue[~car].any()
    assert red[~car & ~there].mean() > 0.2


def test_what_stands_behind_a_vehicle_is_hidden_by_it(whole, conditions):
    image = whole.frames["front"][0].load_point_image()
    assert not share(image, RED)[rear(conditions.insertion, 0)].any()


def test_points_of_sweeps_before_and_after_are_gathered(recorded, conditions):
    alone = replace(recorded, sweeps=recorded.sweeps[:1])
    few = whole_frame(replace(conditions, scene=alone)).frames["front"][0].load_point_mask()
    many = whole_frame(conditions).frames["front"][0].load_point_mask()
    assert many.sum() > 1.5 * few.sum()


def test_a_point_takes_no_colour_of_what_is_before_it(recorded):
    """Points of the wall behind the car are red where another frame shows them, and never blue."""
    still = replace(recorded, tracks=())
    points, colors = StreetPoints(still)._color(0)
    wall = points[:, 0] > 29
    assert wall.any()
    assert (colors[wall] == RED).all()


def test_the_mask_is_where_points_drew(whole):
    frame = whole.frames["front"][1]
    image, mask = frame.load_point_image(), frame.load_point_mask()
    assert 0.05 < mask.mean() < 0.95
    assert (image[mask] != GREY).any(-1).all()


def test_a_drive_without_lidar_is_refused(conditions):
    with pytest.raises(InputError, match="'wall' has none; leave --whole-frame out"):
        whole_frame(replace(conditions, scene=replace(conditions.scene, sweeps=())))
