import json

import numpy as np
import pytest

from dwgs.formats import background_folder
from dwgs.scene import Background, Gaussians, InputError
from dwgs.scene.pose import pose, rotation_from_quat


@pytest.fixture
def background() -> Background:
    rng = np.random.default_rng(0)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (6, 1))
    cloud = Gaussians(
        rng.normal(size=(6, 3)).astype(np.float32),
        quats,
        rng.uniform(0.01, 1, (6, 3)).astype(np.float32),
        rng.uniform(size=6).astype(np.float32),
        rng.normal(size=(6, 4, 3)).astype(np.float32),
    )
    exposure = {"front": rng.uniform(0.8, 1.2, 3).astype(np.float32)}
    poses = {
        (camera, frame): pose(rotation_from_quat(rng.normal(size=4)), rng.normal(size=3) * 1000)
        for camera in ("front", "left")
        for frame in (3, 40)
    }
    return Background(cloud, rng.random((8, 16, 3)).astype(np.float32), exposure, poses)


def test_sky_exposure_and_poses_come_back_to_the_bit(tmp_path, background):
    background_folder.write(background, tmp_path / "bg")
    read = background_folder.read(tmp_path / "bg")
    np.testing.assert_array_equal(read.sky, background.sky)
    assert read.sky.dtype == np.float32
    assert read.poses.keys() == background.poses.keys()
    for key, world_from_camera in background.poses.items():
        np.testing.assert_array_equal(read.poses[key], world_from_camera)
    np.testing.assert_array_equal(read.exposure["front"], background.exposure["front"])
    assert read.exposure["front"].dtype == np.float32
    np.testing.assert_array_equal(read.gaussians.means, background.gaussians.means)


def test_reading_and_writing_changes_no_byte(tmp_path, background):
    background_folder.write(background, tmp_path / "a")
    background_folder.write(background_folder.read(tmp_path / "a"), tmp_path / "b")
    assert background_folder.fingerprint(tmp_path / "a") == background_folder.fingerprint(tmp_path / "b")


@pytest.mark.parametrize("name", background_folder.FILES)
def test_the_fingerprint_sees_one_changed_bit_in_any_file(tmp_path, background, name):
    background_folder.write(background, tmp_path / "bg")
    before = background_folder.fingerprint(tmp_path / "bg")
    data = bytearray((tmp_path / "bg" / name).read_bytes())
    data[-1] ^= 1
    (tmp_path / "bg" / name).write_bytes(data)
    assert background_folder.fingerprint(tmp_path / "bg") != before


def test_a_sky_that_lies_about_its_size_is_refused(tmp_path, background):
    background_folder.write(background, tmp_path / "bg")
    sky = tmp_path / "bg" / "sky.npy"
    data = sky.read_bytes()
    for damaged in (data[:-4], data[:20], b"", data.replace(b"(8, 16, 3)", b"(8000000000, 16, 3)")):
        sky.write_bytes(damaged)
        with pytest.raises(InputError, match=r"sky\.npy"):
            background_folder.read(tmp_path / "bg")


def test_a_sky_that_could_run_code_is_refused(tmp_path, background):
    background_folder.write(background, tmp_path / "bg")
    np.save(tmp_path / "bg" / "sky.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(InputError, match=r"sky\.npy"):
        background_folder.read(tmp_path / "bg")


def test_a_sky_in_another_type_is_refused(tmp_path, background):
    background_folder.write(background, tmp_path / "bg")
    np.save(tmp_path / "bg" / "sky.npy", np.zeros((4, 8, 3)))
    with pytest.raises(InputError, match="float32"):
        background_folder.read(tmp_path / "bg")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "dwgs vehicle asset"}, "format = "),
        ({"gaussians": 5}, "counts 5"),
        ({"exposure": {"front": [1, 2]}}, "three finite gains"),
        ({"exposure": [1]}, "another form"),
        ({"poses": {"front": {"3": [[1, 2], [3, 4]]}}}, "rotation and a translation"),
        ({"poses": {"front": {"x": []}}}, "another form"),
    ],
)
def test_a_document_that_contradicts_is_refused(tmp_path, background, change, message):
    background_folder.write(background, tmp_path / "bg")
    path = tmp_path / "bg" / "background.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InputError, match=message):
        background_folder.read(tmp_path / "bg")


@pytest.mark.parametrize("name", background_folder.FILES)
def test_a_missing_file_is_named(tmp_path, background, name):
    background_folder.write(background, tmp_path / "bg")
    (tmp_path / "bg" / name).unlink()
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        background_folder.read(tmp_path / "bg")
