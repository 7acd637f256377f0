"""A Scene folder gives back every bit, and says what is wrong with it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from dwgs.datasets import folder, open_scene
from dwgs.scene import Camera, Frame, InputError, LidarSweep, Scene, Track, Trajectory
from dwgs.scene.pose import pose, rotation_from_quat
from dwgs.video import write_lossless


@pytest.fixture
def scene() -> Scene:
    """Two cameras of different size, masks on some frames, a sweep with labels and one without, a track."""
    rng = np.random.default_rng(0)

    def trajectory(count: int) -> Trajectory:
        rotations = rotation_from_quat(rng.normal(size=(count, 4)))
        return Trajectory(np.cumsum(rng.random(count) + 0.01), pose(rotations, rng.normal(size=(count, 3))))

    def frame(index: int, name: str, width: int, height: int, has_mask: bool) -> Frame:
        K = np.array([[80 + rng.random(), 0, width / 2], [0, 80 + rng.random(), height / 2], [0, 0, 1]])
        world_from_camera = trajectory(1).world_from_vehicle[0]
        pixels = rng.integers(0, 256, (height, width, 3), np.uint8)
        mask = rng.random((height, width)) > 0.5
        camera = Camera(K, width, height, world_from_camera, index / 3)
        return Frame(index, name, camera, lambda: pixels, (lambda: mask) if has_mask else None)

    def sweep(index: int, labels: bool) -> LidarSweep:
        points = rng.normal(size=(50, 3)).astype(np.float32)
        return LidarSweep(
            points=points,
            times=rng.random(50),
            origin=rng.normal(size=3),
            time=index / 3,
            frame_index=index,
            labels=rng.integers(0, 6, 50, np.uint8) if labels else None,
        )

    return Scene(
        name="drive",
        frames={
            "front": tuple(frame(i, "front", 72, 48, i > 4) for i in (3, 4, 5, 6)),
            "left": tuple(frame(i, "left", 33, 21, False) for i in (3, 4)),
        },
        ego=trajectory(7),
        sweeps=(sweep(3, True), sweep(5, False)),
        tracks=(
            Track("a-1", "Car", rng.random(3) + 1, trajectory(3), True),
            Track("b", "Pedestrian", rng.random(3), trajectory(1), False, False),
        ),
    )


def assert_same(a: Trajectory, b: Trajectory) -> None:
    np.testing.assert_array_equal(a.times, b.times)
    np.testing.assert_array_equal(a.world_from_vehicle, b.world_from_vehicle)


def test_every_bit_comes_back(scene, tmp_path):
    folder.write(scene, tmp_path / "edited")
    back = open_scene(tmp_path / "edited")
    assert (back.name, list(back.frames)) == (scene.name, list(scene.frames))
    for one, two in zip(scene.all_frames(), back.all_frames(), strict=True):
        assert (one.index, one.camera_name, one.camera.time) == (two.index, two.camera_name, two.camera.time)
        np.testing.assert_array_equal(one.camera.K, two.camera.K)
        np.testing.assert_array_equal(one.camera.world_from_camera, two.camera.world_from_camera)
        np.testing.assert_array_equal(one.pixels, two.pixels)
        assert (one.reactive_mask is None) == (two.reactive_mask is None)
        if one.reactive_mask is not None:
            np.testing.assert_array_equal(one.reactive_mask, two.reactive_mask)
            assert two.reactive_mask.dtype == bool
    assert_same(scene.ego, back.ego)
    for one, two in zip(scene.sweeps, back.sweeps, strict=True):
        assert (one.time, one.frame_index) == (two.time, two.frame_index)
        for name in ("points", "times", "origin", "labels"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            assert np.asarray(getattr(one, name)).dtype == np.asarray(getattr(two, name)).dtype
    for one, two in zip(scene.tracks, back.tracks, strict=True):
        assert (one.id, one.category, one.is_moving, one.is_vehicle) == (
            two.id,
            two.category,
            two.is_moving,
            two.is_vehicle,
        )
        np.testing.assert_array_equal(one.size, two.size)
        assert_same(one.trajectory, two.trajectory)


def test_writing_what_was_read_makes_the_same_files(scene, tmp_path):
    folder.write(scene, tmp_path / "a")
    folder.write(folder.read(tmp_path / "a"), tmp_path / "b")
    names = sorted(file.name for file in (tmp_path / "a").iterdir())
    assert names == ["front.avi", "front.reactive_mask.avi", "left.avi", "scene.json", "sweeps.safetensors"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_a_scene_may_be_written_over_itself_and_progress_is_told(scene, tmp_path):
    folder.write(scene, tmp_path / "a")
    heard = []
    folder.write(folder.read(tmp_path / "a"), tmp_path / "a", lambda done, total: heard.append((done, total)))
    assert heard == [(i, 6) for i in range(1, 7)]
    np.testing.assert_array_equal(folder.read(tmp_path / "a").all_frames()[2].pixels, scene.all_frames()[2].pixels)


def test_without_sweeps_there_is_no_sweep_file(scene, tmp_path):
    folder.write(replace(scene, sweeps=()), tmp_path / "a")
    assert not (tmp_path / "a" / "sweeps.safetensors").exists()
    assert folder.read(tmp_path / "a").sweeps == ()


def test_a_frame_that_cannot_be_read_leaves_nothing_behind(scene, tmp_path):
    def fail():
        raise InputError("the disk is gone")

    broken = replace(scene.frames["front"][2], load_pixels=fail)
    with pytest.raises(InputError, match="the disk is gone"):
        folder.write(replace(scene, frames={"front": (scene.frames["front"][0], broken)}), tmp_path / "a")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["../up", "a/b", "", ".hidden"])
def test_a_camera_name_is_a_file_name(scene, tmp_path, name):
    with pytest.raises(InputError, match="a camera name is"):
        folder.write(replace(scene, frames={name: scene.frames["left"]}), tmp_path / "a")
    folder.write(scene, tmp_path / "a")
    edit(tmp_path / "a", lambda d: d["cameras"].update({name: d["cameras"].pop("left")}))
    with pytest.raises(InputError, match="a camera name is"):
        folder.read(tmp_path / "a")


def edit(path, change) -> None:
    document = json.loads((path / "scene.json").read_text())
    change(document)
    (path / "scene.json").write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda d: d.pop("format"), 'lacks "format": "dwgs-scene"'),
        (lambda d: d.update(version=99), "is a scene of version 99, this program reads version 1"),
        (lambda d: d.pop("ego"), "is damaged"),
        (lambda d: d["cameras"]["front"][0].pop("K"), "is damaged"),
        (lambda d: d["cameras"].update(front=3), "is damaged"),
        (lambda d: d.update(cameras=[]), "is damaged"),
        (lambda d: d["cameras"].clear(), "at least one camera"),
        (lambda d: d["cameras"]["front"][0].update(K=[[1, 2]]), "is damaged"),
        (lambda d: d["cameras"]["front"][0].update(width=10**12), "not the 4 that scene.json describes"),
        (lambda d: d["cameras"]["front"][0].update(width=-1), "at least one pixel"),
        (lambda d: d["cameras"]["front"].pop(), "holds 4 frames of 72x48, not the 3"),
        (lambda d: d["cameras"].update(rear=d["cameras"]["front"]), "there is no video '.*rear.avi'"),
        (lambda d: d["ego"]["times"].reverse(), "strictly increasing"),
        (lambda d: d["ego"].update(times="soon"), "is damaged"),
        (lambda d: d["sweeps"].append(d["sweeps"][0]), "sweeps.safetensors' is missing or damaged"),
        (lambda d: d["sweeps"][0].update(origin=[1, 2]), "is damaged"),
        (lambda d: d["tracks"][0].update(size=[1e999, 1, 1]), "is damaged"),
    ],
)
def test_a_wrong_document_is_refused_in_a_sentence(scene, tmp_path, change, sentence):
    folder.write(scene, tmp_path / "a")
    edit(tmp_path / "a", change)
    with pytest.raises(InputError, match=sentence):
        folder.read(tmp_path / "a")


def test_wrong_files_are_refused_in_a_sentence(scene, tmp_path):
    path = tmp_path / "a"
    folder.write(scene, path)
    sweeps = (path / "sweeps.safetensors").read_bytes()
    for content in (b"", sweeps[:100], b"\xff" * 8 + sweeps[8:], sweeps[:-10]):
        (path / "sweeps.safetensors").write_bytes(content)
        with pytest.raises(InputError, match=r"sweeps\.safetensors' is missing or damaged"):
            folder.read(path)
    (path / "sweeps.safetensors").write_bytes(sweeps)
    write_lossless(path / "left.avi", np.zeros((2, 8, 8, 3), np.uint8))
    with pytest.raises(InputError, match="holds 2 frames of 8x8"):
        folder.read(path)
    (path / "scene.json").write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        folder.read(path)
    (path / "scene.json").unlink()
    with pytest.raises(InputError, match=r"there is no '.*scene\.json'"):
        folder.read(path)
