import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_vehicle import drive

from dwgs.scene import InputError, Insertion, Scene
from generator.conditions import make_conditions, read, read_insertion, write, write_insertion


def images(frame):
    return (
        frame.load_point_image(),
        frame.load_point_mask(),
        frame.load_reactive_mask(),
        frame.load_inactive_image(),
    )


def test_every_frame_gets_points_masks_and_a_grey_hole(scene: Scene, insertion: Insertion):
    told = []
    conditions = make_conditions(scene, insertion, lambda *progress: told.append(progress))
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [f.frame.index for f in conditions.frames["front"]] == [10, 11, 12]
    for frame in conditions.frames["front"]:
        points, drawn, reactive, inactive = images(frame)
        assert points.shape == inactive.shape == (120, 160, 3)
        assert drawn.dtype == reactive.dtype == bool
        assert drawn.any()
        assert not (drawn & ~reactive).any()
        assert (inactive[reactive] == 127).all()
        assert (inactive[~reactive] == (0, 200, 0)).all()
        assert (points[~reactive] == 127).all()


def test_the_vehicle_shrinks_as_it_drives_away(scene: Scene, insertion: Insertion):
    conditions = make_conditions(scene, insertion)
    sizes = [f.load_reactive_mask().sum() for f in conditions.frames["front"]]
    assert sizes[0] > sizes[1] > sizes[2]


def test_conditions_read_back_bit_by_bit(tmp_path: Path, scene: Scene, insertion: Insertion):
    conditions = make_conditions(scene, insertion)
    write(conditions, tmp_path / "c")
    found = read(tmp_path / "c", scene)
    for ours, theirs in zip(conditions.frames["front"], found.frames["front"], strict=True):
        for a, b in zip(images(ours), images(theirs), strict=True):
            np.testing.assert_array_equal(a, b)
    names = {p.relative_to(tmp_path / "c").as_posix() for p in (tmp_path / "c").rglob("*") if p.is_file()}
    assert names == {
        "conditions.json", "insertion/insertion.json", "insertion/points.ply",
        *(f"front/{n}.avi" for n in ("points", "point_mask", "reactive_mask", "inactive")),
    }  # fmt: skip


def test_an_insertion_reads_back_exactly(tmp_path: Path, insertion: Insertion):
    write_insertion(insertion, tmp_path / "i")
    found = read_insertion(tmp_path / "i")
    np.testing.assert_array_equal(found.vehicle.points, insertion.vehicle.points)
    np.testing.assert_array_equal(found.vehicle.normals, insertion.vehicle.normals)
    np.testing.assert_array_equal(found.trajectory.world_from_vehicle, insertion.trajectory.world_from_vehicle)
    np.testing.assert_array_equal(found.size, insertion.size)
    assert found.vehicle.is_complete


def test_a_trajectory_shorter_than_the_clip_is_refused(scene: Scene, insertion: Insertion):
    with pytest.raises(InputError, match=r"covers 0.00-0.10 s but frame 2 of the clip is at 0.20 s"):
        make_conditions(scene, replace(insertion, trajectory=drive(8, frames=2)))


@pytest.mark.parametrize(
    ("x", "y", "says"), [(-9.0, 0.0, "behind the camera in every"), (9.0, 60.0, "outside the image in every")]
)
def test_a_vehicle_that_no_frame_sees_is_refused(scene: Scene, insertion: Insertion, x: float, y: float, says: str):
    with pytest.raises(InputError, match=says):
        make_conditions(scene, replace(insertion, trajectory=drive(x, y)))


def test_conditions_of_other_frames_are_refused_by_name(tmp_path: Path, scene: Scene, insertion: Insertion):
    write(make_conditions(scene, insertion), tmp_path / "c")
    with pytest.raises(InputError, match=r"front 10-12 \(3 frames of 160x120\), but 'green' has front 10-11"):
        read(tmp_path / "c", scene.select(frames=range(10, 12)))


def test_a_damaged_folder_is_refused(tmp_path: Path, scene: Scene, insertion: Insertion):
    with pytest.raises(InputError, match="no dwgs conditions folder"):
        read(tmp_path, scene)
    write(make_conditions(scene, insertion), tmp_path / "c")
    document = tmp_path / "c" / "insertion" / "insertion.json"
    said = json.loads(document.read_text())
    document.write_text(json.dumps({**said, "size": [4, -1, 1]}))
    with pytest.raises(InputError, match="three positive lengths"):
        read(tmp_path / "c", scene)
    document.write_text(json.dumps({**said, "trajectory": {}}))
    with pytest.raises(InputError, match="lacks or garbles 'times'"):
        read(tmp_path / "c", scene)
    (tmp_path / "c" / "front" / "points.avi").unlink()
    with pytest.raises(InputError, match=r"points.avi"):
        read(tmp_path / "c", scene)


def test_a_camera_that_is_no_folder_is_refused_and_nothing_is_left(tmp_path: Path, scene: Scene, insertion: Insertion):
    odd = replace(scene, frames={"../front": scene.frames["front"]})
    with pytest.raises(InputError, match="camera's name"):
        write(make_conditions(odd, insertion), tmp_path / "c")
    assert list(tmp_path.iterdir()) == []


def test_making_them_twice_gives_the_same_bytes(scene: Scene, insertion: Insertion):
    first, second = (make_conditions(scene, insertion).frames["front"][0] for _ in range(2))
    assert first.load_point_image().tobytes() == second.load_point_image().tobytes()
