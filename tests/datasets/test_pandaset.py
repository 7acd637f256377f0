"""A PandaSet folder becomes a Scene in this project's frames, times and classes."""

import json

import numpy as np
import pytest
from PIL import Image

from dwgs.datasets import open_scene, pandaset
from dwgs.scene import InputError
from dwgs.scene.lidar import SURFACES


def test_frames_are_indexed_by_number_and_the_front_camera_is_the_main_one(pandaset_folder):
    scene = open_scene(pandaset_folder)
    assert list(scene.frames) == ["front_camera", "left_camera"]
    assert scene.name == "042"
    frames = scene.frames["front_camera"]
    assert [frame.index for frame in frames] == [3, 4, 5, 6, 7]
    np.testing.assert_allclose([frame.camera.time for frame in frames], [0.25, 0.35, 0.45, 0.55, 0.65], atol=1e-6)
    np.testing.assert_allclose(frames[0].camera.position, (0, 2 * 0.3, 1.8), atol=1e-6)


def test_pixels_are_read_when_asked_for(pandaset_folder):
    frame = open_scene(pandaset_folder).frames["front_camera"][1]
    assert frame.pixels.shape == (48, 64, 3)
    assert abs(frame.pixels.astype(int) - (40, 100, 200)).max() <= 3


def test_axes_are_ours_and_pixel_centres_lie_at_a_half(pandaset_folder):
    scene = open_scene(pandaset_folder)
    np.testing.assert_allclose(scene.ego.at(0.3)[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-9)
    camera = scene.frames["front_camera"][0].camera
    np.testing.assert_allclose(camera.world_from_camera[:3, 2], (0, 1, 0), atol=1e-9)
    pixel, depth = camera.project([[0, 10.6, 1.8], [1, 10.6, 0.8]])
    np.testing.assert_allclose(depth, 10, atol=1e-5)
    np.testing.assert_allclose(pixel, [[32, 24], [37, 29]], atol=1e-4)


def test_a_frame_may_lack_its_sweep_and_points_are_labelled_by_surface(pandaset_folder):
    sweeps = open_scene(pandaset_folder).sweeps
    assert [sweep.frame_index for sweep in sweeps] == [3, 4, 6, 7]
    assert sweeps[0].points.shape == (4050, 3)  # the point that is not a number is gone
    assert sweeps[0].points.dtype == np.float32
    assert [SURFACES[label] for label in sweeps[0].labels[[0, -1]]] == ["ground", "vehicle"]
    assert sweeps[0].time == pytest.approx(0.3, abs=1e-6)
    np.testing.assert_allclose(sweeps[0].times[[0, -1]], [0.29, 0.26], atol=1e-6)


def test_the_two_boxes_of_a_moving_object_are_one_track(pandaset_folder):
    scene = open_scene(pandaset_folder)
    assert [track.id for track in scene.tracks] == ["aaaa-car", "cccc-parked"]
    car, parked = scene.tracks
    assert (car.is_moving, parked.is_moving, car.is_vehicle) == (True, False, True)
    np.testing.assert_allclose(car.size, (4.5, 1.9, 1.5))


def test_a_box_is_where_its_points_were_when_they_were_hit(pandaset_folder):
    """Points were hit 40 ms before the stamp: at any time the track is where the car truly is.

    Frame 5 has no sweep and no points: its box takes the lead of its neighbours.
    """
    car = open_scene(pandaset_folder).track("aaaa")
    times = np.arange(0.22, 0.69, 0.01)
    truth = np.stack([np.full_like(times, -3), 5 * times, np.full_like(times, 0.75)], 1)
    np.testing.assert_allclose(car.trajectory.at(times)[:, :3, 3], truth, atol=1e-5)
    np.testing.assert_allclose(car.trajectory.at(0.3)[:3, 0], (0, 1, 0), atol=1e-9)  # x forward


def test_a_track_covers_the_images_of_its_first_and_last_frame(pandaset_folder):
    scene = open_scene(pandaset_folder)
    times = [frame.camera.time for frame in scene.all_frames()]
    assert all(track.trajectory.covers(times).all() for track in scene.tracks)


def test_a_box_that_names_itself_its_sibling_stays(pandaset_folder, write_table):
    for file in (pandaset_folder / "annotations/cuboids").iterdir():
        table = pandaset.read_table(file)
        table["cuboids.sibling_id"] = np.array(["aaaa-car", "aaaa-car", "-"], object)
        write_table(file, table)
    assert [track.id for track in open_scene(pandaset_folder).tracks] == ["aaaa-car", "cccc-parked"]


def test_without_annotations_there_are_no_tracks_and_no_labels(pandaset_folder):
    (pandaset_folder / "annotations").rename(pandaset_folder / "elsewhere")
    scene = open_scene(pandaset_folder)
    assert scene.tracks == ()
    assert all(sweep.labels is None for sweep in scene.sweeps)


def test_a_corrupt_image_is_named_when_its_pixels_are_read(pandaset_folder):
    file = pandaset_folder / "camera/front_camera/04.jpg"
    file.write_bytes(file.read_bytes()[:200])
    frame = open_scene(pandaset_folder).frames["front_camera"][1]
    with pytest.raises(InputError, match=r"04\.jpg' is not a whole JPEG"):
        frame.load_pixels()
    file.unlink()
    with pytest.raises(InputError, match=r"there is no image '.*04\.jpg'"):
        frame.load_pixels()


def test_an_image_of_another_size_is_noticed(pandaset_folder):
    Image.new("RGB", (32, 48)).save(pandaset_folder / "camera/front_camera/04.jpg")
    with pytest.raises(InputError, match="frame 4 of front_camera"):
        _ = open_scene(pandaset_folder).frames["front_camera"][1].pixels


@pytest.mark.parametrize(
    ("file", "content", "sentence"),
    [
        ("lidar/timestamps.json", None, "there is no '.*timestamps.json'"),
        ("lidar/timestamps.json", "[", "is not JSON"),
        ("lidar/timestamps.json", '["soon"]', "is a list of times"),
        ("lidar/poses.json", "[]", "a position and a unit heading for each of 10 stamps"),
        ("lidar/poses.json", '{"position": 1}', "a position and a unit heading"),
        ("camera/front_camera/intrinsics.json", '{"fx": 50}', "has fx, fy, cx and cy as numbers"),
        ("camera/front_camera/timestamps.json", "[1, 2]", "each of 2 stamps"),
        ("annotations/semseg/classes.json", None, "there is no '.*classes.json'"),
    ],
)
def test_a_broken_file_is_named_in_a_sentence(pandaset_folder, file, content, sentence):
    if content is None:
        (pandaset_folder / file).unlink()
    else:
        (pandaset_folder / file).write_text(content)
    with pytest.raises(InputError, match=sentence):
        pandaset.read(pandaset_folder)


def test_a_table_of_other_columns_is_named(pandaset_folder, write_table):
    write_table(pandaset_folder / "lidar/03.pkl.gz", {"x": np.zeros(3), "y": np.zeros(3)})
    with pytest.raises(InputError, match=r"03\.pkl\.gz' is a table with the columns x, y, z, t and d, it has x, y"):
        pandaset.read(pandaset_folder)


def test_labels_of_another_sweep_are_refused(pandaset_folder, write_table):
    write_table(pandaset_folder / "annotations/semseg/03.pkl.gz", {"class": np.zeros(3, int)})
    with pytest.raises(InputError, match="one integer class for each of the sweep's 4051 points"):
        pandaset.read(pandaset_folder)


def test_frames_without_stamps_are_refused(pandaset_folder):
    file = pandaset_folder / "lidar/07.pkl.gz"
    file.rename(file.with_name("12.pkl.gz"))
    with pytest.raises(InputError, match="has frame 12 but stamps for frames 0-9 only"):
        pandaset.read(pandaset_folder)


def test_boxes_without_extent_are_refused(pandaset_folder, write_table):
    file = pandaset_folder / "annotations/cuboids/03.pkl.gz"
    write_table(file, pandaset.read_table(file) | {"dimensions.x": np.zeros(3)})
    with pytest.raises(InputError, match="positive sizes"):
        pandaset.read(pandaset_folder)


def test_a_folder_that_is_no_drive_says_what_was_looked_for(pandaset_folder, tmp_path):
    with pytest.raises(InputError, match=r"neither scene\.json .* nor lidar/poses\.json .*did you mean '.*042'"):
        open_scene(tmp_path)
    with pytest.raises(InputError, match="there is no folder"):
        open_scene(tmp_path / "nothing")
    with pytest.raises(InputError, match="there is no folder"):
        pandaset.read(tmp_path / "nothing")


def test_json_keys_may_come_in_any_order(pandaset_folder):
    file = pandaset_folder / "lidar/poses.json"
    poses = [dict(reversed(pose.items())) for pose in json.loads(file.read_text())]
    before = pandaset.read(pandaset_folder).ego
    file.write_text(json.dumps(poses))
    np.testing.assert_array_equal(pandaset.read(pandaset_folder).ego.world_from_vehicle, before.world_from_vehicle)
