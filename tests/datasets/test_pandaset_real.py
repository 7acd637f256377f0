"""The reader on a real recording: points fall on pixels, boxes on cars."""

from pathlib import Path

import numpy as np
import pytest

from dwgs.datasets import open_scene, resize_scene
from dwgs.scene import Scene
from dwgs.scene.ground import Ground
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import inverse, transform_points

DRIVE = Path(__file__).parents[2].parent / "shared" / "data" / "pandaset-002" / "002"
pytestmark = pytest.mark.skipif(not DRIVE.is_dir(), reason=f"needs the recording {DRIVE}")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return open_scene(DRIVE)


def test_frames_and_the_four_missing_sweeps(scene):
    assert list(scene.frames) == ["front_camera", "front_left_camera", "front_right_camera"]
    assert all([f.index for f in frames] == list(range(30, 79)) for frames in scene.frames.values())
    assert sorted(set(range(30, 79)) - {s.frame_index for s in scene.sweeps}) == [56, 57, 58, 71]
    assert scene.frames["front_camera"][0].pixels.shape == (1080, 1920, 3)


def test_the_ego_faces_where_it_drives_and_where_the_front_camera_looks(scene):
    first, last = scene.ego.at(4.0), scene.ego.at(7.8)
    driven = last[:3, 3] - first[:3, 3]
    assert driven @ last[:3, 0] / np.linalg.norm(driven) > 0.999
    camera = scene.frames["front_camera"][-1].camera
    assert camera.world_from_camera[:3, 2] @ last[:3, 0] > 0.999
    left = scene.frames["front_left_camera"][-1].camera
    assert left.world_from_camera[:3, 2] @ last[:3, 1] > 0.5


def test_cameras_are_bolted_to_the_ego(scene):
    """Stamps and poses belong together: between the ego and any camera nothing moves by a centimetre."""
    for frames in scene.frames.values():
        times = np.array([frame.camera.time for frame in frames])
        ego_from_camera = inverse(scene.ego.at(times)) @ np.stack([f.camera.world_from_camera for f in frames])
        assert np.ptp(ego_from_camera[:, :3, 3], axis=0).max() < 0.02


def test_points_on_the_road_show_the_colour_of_asphalt_and_points_on_trees_are_green(scene):
    """Labelled points fall on pixels of their kind at working size: K follows the crop."""
    small = resize_scene(scene, 720, 480)
    frame = next(f for f in small.frames["front_camera"] if f.index == 45)
    sweep = next(s for s in scene.sweeps if s.frame_index == 45)
    pixels, depth = frame.camera.project(sweep.points)
    seen = (depth > 1) & (pixels >= 0).all(1) & (pixels < (720, 480)).all(1)
    column, row = pixels[seen].astype(int).T
    colours = frame.pixels[row, column].astype(float)
    labels = sweep.labels[seen]
    road = colours[labels == SURFACES.index("ground")]
    assert len(road) > 2000
    assert np.median(np.ptp(road, axis=1)) < 25  # grey
    image = frame.pixels.astype(float)
    leaves = (image[..., 1] > image[..., 2] + 25) & (image[..., 1] > 60)
    hits = leaves[row, column]
    static = labels == SURFACES.index("static")
    assert hits[static].mean() > 5 * hits[labels == SURFACES.index("ground")].mean()


def test_the_car_that_overtakes_is_one_track_with_the_id_of_the_spinning_lidar(scene):
    car = scene.track("0d238564")
    assert car.is_moving
    assert car.is_vehicle
    assert not any(track.id.startswith("58c7bb66") for track in scene.tracks)
    np.testing.assert_allclose(car.size, (4.41, 1.89, 1.67), atol=0.01)
    assert car.trajectory.covers([f.camera.time for f in scene.frames["front_camera"]]).all()


def test_a_moving_box_is_dated_by_its_points_not_by_the_stamp(scene):
    """Its speed is smooth, and at each sweep its points lie in the box of *their* time, not of the stamp's.

    At the time of the stamp, 50 to 67 ms later, the box has gone on by up to half a metre.
    """
    car = scene.track("0d238564")
    sweeps = [s for s in scene.sweeps if 45 <= s.frame_index <= 70]
    counts = {"points": 0, "stamp": 0}
    for sweep in sweeps:
        for name, shift in (("points", 0.0), ("stamp", sweep.time)):
            near = np.linalg.norm(sweep.points - car.trajectory.at(sweep.time - 0.06)[:3, 3], axis=1) < 3.5
            near &= sweep.labels == SURFACES.index("vehicle")
            time = shift or float(np.median(sweep.times[near]))
            local = transform_points(inverse(car.trajectory.at(time)), sweep.points[near])
            counts[name] += int((abs(local) <= car.size / 2 + 0.02).all(1).sum())
    assert counts["points"] > 5000
    assert counts["stamp"] < 0.8 * counts["points"]


def test_the_front_camera_sees_boxes_within_a_few_milliseconds_of_their_own_time(scene):
    car = scene.track("0d238564").trajectory.times[1:-1]
    camera = np.array([f.camera.time for f in scene.frames["front_camera"]])
    assert abs(car - camera[: len(car)]).max() < 0.02


def test_parked_cars_stand_on_the_ground(scene):
    ground = Ground.from_sweeps(scene.sweeps, scene.ego)
    ego = scene.ego.at(5.0)[:2, 3]
    gaps = []
    for track in scene.tracks:
        at = track.trajectory.world_from_vehicle[0, :3, 3]
        if track.category == "Car" and np.linalg.norm(at[:2] - ego) < 25:
            gaps.append(at[2] - track.size[2] / 2 - ground.height(at[:2]))
    assert len(gaps) > 10
    assert abs(np.median(gaps)) < 0.05
    assert np.abs(gaps).max() < 0.2
