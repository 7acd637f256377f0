import json
from dataclasses import replace

import numpy as np
import pytest

from dwgs.formats import asset_folder
from dwgs.scene import Casting, Gaussians, InputError, Shading, VehicleAsset, Wheel


def cloud(n: int, seed: int) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return Gaussians(
        rng.normal(size=(n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.01, 0.1, (n, 3)).astype(np.float32),
        rng.uniform(size=n).astype(np.float32),
        rng.normal(size=(n, 4, 3)).astype(np.float32),
    )


@pytest.fixture
def asset() -> VehicleAsset:
    provenance, quality = {"scene": "street", "seed": 3}, {"psnr": 39.7, "azimuths": [0.1, 2.0]}
    seen = np.arange(9, dtype=np.uint32)
    return VehicleAsset(cloud(9, 0), cloud(4, 1), np.array([4.4, 1.85, 1.5]), "van", provenance, quality, seen)


def test_an_asset_comes_back(tmp_path, asset):
    asset_folder.write(asset, tmp_path / "asset")
    assert sorted(p.name for p in (tmp_path / "asset").iterdir()) == [
        "asset.json",
        "gaussians.ply",
        "observations.npy",
        "shadow.ply",
    ]
    read = asset_folder.read(tmp_path / "asset")
    np.testing.assert_array_equal(read.size, asset.size)
    assert (read.category, read.provenance, read.quality) == ("van", asset.provenance, asset.quality)
    np.testing.assert_array_equal(read.body.means, asset.body.means)
    np.testing.assert_array_equal(read.shadow.sh, asset.shadow.sh)
    np.testing.assert_array_equal(read.observations, asset.observations)


def test_an_asset_without_a_shadow_comes_back(tmp_path, asset):
    bare = VehicleAsset(asset.body, Gaussians.empty(), asset.size)
    asset_folder.write(bare, tmp_path / "asset")
    read = asset_folder.read(tmp_path / "asset")
    assert len(read.shadow) == 0
    assert read.observations is None


@pytest.fixture
def sunny(asset):
    casting = Casting(np.array([0.6, 0, 0.8]), np.array([0, 0.6, 0.8]), np.float32([0.1, 0.4, 1.2, 0]))
    by_slope = np.random.default_rng(0).normal(size=(len(asset.body), 2, 3)).astype(np.float32)
    return replace(asset, casting=casting, shading=Shading(by_slope, np.array([[-0.1, -0.4], [0.2, 0]])))


def test_the_sun_and_what_casts_the_shadow_come_back(tmp_path, sunny):
    asset_folder.write(sunny, tmp_path / "asset")
    read = asset_folder.read(tmp_path / "asset").casting
    np.testing.assert_array_equal(read.sun, sunny.casting.sun)
    np.testing.assert_array_equal(read.sun_at_rest, sunny.casting.sun_at_rest)
    np.testing.assert_array_equal(read.heights, sunny.casting.heights)


def test_how_colours_follow_the_sun_comes_back(tmp_path, sunny):
    asset_folder.write(sunny, tmp_path / "asset")
    read = asset_folder.read(tmp_path / "asset").shading
    np.testing.assert_array_equal(read.by_slope, sunny.shading.by_slope)
    np.testing.assert_array_equal(read.slopes, sunny.shading.slopes)
    asset_folder.write(replace(sunny, shading=None), tmp_path / "asset")
    assert asset_folder.read(tmp_path / "asset").shading is None


@pytest.mark.parametrize("slopes", [[[0, 0]], [[0, 1], [0, 0]], "steep", [[0, 0], [0, float("inf")]]])
def test_slopes_that_are_none_are_refused(tmp_path, sunny, slopes):
    asset_folder.write(sunny, tmp_path / "asset")
    file = tmp_path / "asset" / "asset.json"
    document = json.loads(file.read_text())
    document["sun"]["slopes"] = slopes
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match="slopes"):
        asset_folder.read(tmp_path / "asset")


@pytest.mark.parametrize("spoil", [lambda p: p.unlink(), lambda p: np.save(p, np.full((9, 2, 3), np.nan, np.float32))])
def test_slopes_without_colours_are_refused(tmp_path, sunny, spoil):
    asset_folder.write(sunny, tmp_path / "asset")
    spoil(tmp_path / "asset" / "body_shading.npy")
    with pytest.raises(InputError, match=r"body_shading\.npy"):
        asset_folder.read(tmp_path / "asset")


@pytest.mark.parametrize(
    ("sun", "message"),
    [
        ({"in_world": [0, 0, 1]}, "two directions"),
        ({"in_world": [0, 0, 1], "in_vehicle": [1, 0, 0]}, "z above 0"),
        ({"in_world": [0, 0, 1], "in_vehicle": [0, 1]}, "x, y, z"),
        ([0, 0, 1], "two directions"),
    ],
)
def test_a_sun_that_casts_no_shadow_is_refused(tmp_path, sunny, sun, message):
    asset_folder.write(sunny, tmp_path / "asset")
    file = tmp_path / "asset" / "asset.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"sun": sun}))
    with pytest.raises(InputError, match=message):
        asset_folder.read(tmp_path / "asset")


def test_a_sun_without_heights_is_refused(tmp_path, sunny):
    asset_folder.write(sunny, tmp_path / "asset")
    (tmp_path / "asset" / "shadow_heights.npy").unlink()
    with pytest.raises(InputError, match=r"shadow_heights\.npy"):
        asset_folder.read(tmp_path / "asset")


@pytest.fixture
def rolling(asset):
    return replace(asset, wheels=(Wheel(np.array([1.3, -0.8, 0.1]), 0.34, 3), Wheel(np.array([-1.3, 0, 0]), 0.3, 4)))


def test_wheels_come_back(tmp_path, rolling):
    asset_folder.write(rolling, tmp_path / "asset")
    read = asset_folder.read(tmp_path / "asset")
    assert len(read.body) == 9  # at rest every viewer shows all of it
    for a, b in zip(read.wheels, rolling.wheels, strict=True):
        np.testing.assert_array_equal(a.hub, b.hub)
        assert (a.radius, a.count) == (b.radius, b.count)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 0}, "a radius positive"),
        ({"radius": float("inf")}, "a radius positive"),
        ({"radius": "wide"}, "without hub, radius"),
        ({"hub": [1, 2]}, "a hub is x, y, z"),
        ({"hub": [1, 2, float("nan")]}, "a hub is x, y, z"),
        ({"gaussians": 6}, "each has some of the body's 9"),
        ({"gaussians": 0}, "each has some"),
        ({"gaussians": -1}, "each has some"),
        ({"gaussians": 10**30}, "each has some"),
        ({"gaussians": 2.5}, "a number of Gaussians"),
        ({"gaussians": None}, "a number of Gaussians"),
    ],
)
def test_a_wheel_that_cannot_roll_is_refused(tmp_path, rolling, change, message):
    asset_folder.write(rolling, tmp_path / "asset")
    file = tmp_path / "asset" / "asset.json"
    document = json.loads(file.read_text())
    document["wheels"][0] |= change
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message):
        asset_folder.read(tmp_path / "asset")


@pytest.mark.parametrize("wheels", [7, None, [7], {"hub": 1}])
def test_wheels_that_are_no_list_of_wheels_are_refused(tmp_path, rolling, wheels):
    asset_folder.write(rolling, tmp_path / "asset")
    file = tmp_path / "asset" / "asset.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"wheels": wheels}))
    with pytest.raises(InputError, match="wheel"):
        asset_folder.read(tmp_path / "asset")


def huge(path):
    """A header that promises 8 TiB."""
    np.save(path, np.zeros(9, np.uint32))
    path.write_bytes(path.read_bytes().replace(b"(9,), }     ", b"(2199023255552,), }")[:128] + bytes(36))


@pytest.mark.parametrize(
    "spoil",
    [
        huge,
        lambda path: path.write_bytes(b""),
        lambda path: path.write_bytes(b"not numbers"),
        lambda path: np.save(path, np.array([{}] * 9), allow_pickle=True),
        lambda path: np.save(path, np.zeros(8, np.uint32)),
        lambda path: np.save(path, np.zeros(9)),
    ],
)
def test_observations_of_something_else_are_refused(tmp_path, asset, spoil):
    asset_folder.write(asset, tmp_path / "asset")
    spoil(tmp_path / "asset" / "observations.npy")
    with pytest.raises(InputError, match=r"observations\.npy"):
        asset_folder.read(tmp_path / "asset")


def test_writing_again_gives_the_same_bytes(tmp_path, asset):
    asset_folder.write(asset, tmp_path / "a")
    asset_folder.write(asset_folder.read(tmp_path / "a"), tmp_path / "b")
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_version": 2}, r"format_version = 2, this version reads 1"),
        ({"format": "something"}, r"format = \"something\""),
        ({"frame": {"axes": "x right, y down, z forward"}}, "frame = "),
        ({"size": [4, 2]}, "three positive lengths"),
        ({"size": [4, 2, -1]}, "three positive lengths"),
        ({"size": "big"}, "another form"),
        ({"gaussians": {"body": 8, "shadow": 4}}, "mixture"),
        ({"gaussians": 13}, "another form"),
        ({"provenance": [1]}, "another form"),
    ],
)
def test_a_document_that_contradicts_is_refused(tmp_path, asset, change, message):
    asset_folder.write(asset, tmp_path / "asset")
    path = tmp_path / "asset" / "asset.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InputError, match=message):
        asset_folder.read(tmp_path / "asset")


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "[" * 100_000])
def test_a_document_that_is_no_document_is_refused(tmp_path, asset, text):
    asset_folder.write(asset, tmp_path / "asset")
    (tmp_path / "asset" / "asset.json").write_text(text)
    with pytest.raises(InputError, match=r"asset\.json"):
        asset_folder.read(tmp_path / "asset")


@pytest.mark.parametrize("name", ["asset.json", "gaussians.ply", "shadow.ply"])
def test_a_missing_file_is_named(tmp_path, asset, name):
    asset_folder.write(asset, tmp_path / "asset")
    (tmp_path / "asset" / name).unlink()
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        asset_folder.read(tmp_path / "asset")


def test_what_is_no_json_leaves_the_former_asset_in_place(tmp_path, asset):
    asset_folder.write(asset, tmp_path / "asset")
    for bad in (float("nan"), object()):
        broken = VehicleAsset(asset.body, asset.shadow, asset.size, quality={"psnr": bad})
        with pytest.raises(InputError, match="JSON"):
            asset_folder.write(broken, tmp_path / "asset")
    assert asset_folder.read(tmp_path / "asset").quality == asset.quality
    assert [p.name for p in tmp_path.iterdir()] == ["asset"]
