"""Wheels that roll are learnt as such, and drive on elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from rolling_car import HUBS, RADIUS, SPOKES, drive, scene_of
from test_distill import run, same

from dwgs.distill import DistillConfig
from dwgs.formats import asset_folder

CONFIG = DistillConfig(steps=150, gaussians=3000, shadow_margin=0.0, threads=1)


@pytest.fixture(scope="module")
def rolling():
    return run(*scene_of(drive()), CONFIG)


@pytest.fixture(scope="module")
def without():
    patch = pytest.MonkeyPatch()
    with patch.context() as p:
        p.setattr("dwgs.distill.fit.find_wheels", lambda *_: None)
        return run(*scene_of(drive()), CONFIG)


def test_held_out_frames_are_better_with_wheels_that_roll(rolling, without):
    assert rolling[2]["psnr_roi_heldout"] > without[2]["psnr_roi_heldout"] + 0.5
    assert without[2]["wheels"] is None


def test_the_asset_says_where_and_how_its_wheels_roll(rolling):
    _, asset, report = rolling
    assert report["wheels"]["spokes"] == SPOKES
    assert asset.quality["wheels"]["radius_m"] == pytest.approx(RADIUS, rel=0.01)
    assert len(asset.observations) == len(asset.body)
    right = np.array([wheel.hub for wheel in asset.wheels[:2]])
    np.testing.assert_allclose(right[:, [0, 2]], HUBS[:, [0, 2]], atol=0.04)


def test_the_side_that_no_frame_shows_has_the_mirror_image(rolling):
    wheels, body = rolling[1].wheels, rolling[1].body
    assert len(wheels) == 4
    np.testing.assert_allclose(wheels[2].hub, wheels[0].hub * [1, -1, 1])
    count = sum(wheel.count for wheel in wheels)
    assert len({wheel.count for wheel in wheels}) == 1
    right, left = body[-count : -count // 2], body[-count // 2 :]
    assert same(left, right.mirrored())


def test_spokes_are_alike(rolling):
    wheel, body = rolling[1].wheels[-1], rolling[1].body
    parts = body[-wheel.count :].opacities.reshape(SPOKES, -1)
    np.testing.assert_array_equal(parts, np.broadcast_to(parts[0], parts.shape))


def test_the_same_input_gives_the_same_wheels(rolling):
    assert same(run(*scene_of(drive()), CONFIG)[1].gaussians, rolling[1].gaussians)


def test_wheels_that_slide_stay_with_the_body():
    _, asset, report = run(*scene_of(drive(), radius=np.inf), replace(CONFIG, steps=40))
    assert asset.wheels == ()
    assert report["wheels"] is None


def test_an_asset_with_wheels_is_kept(rolling, tmp_path):
    asset_folder.write(rolling[1], tmp_path / "asset")
    read, trajectory = asset_folder.read(tmp_path / "asset"), drive()
    for a, b in zip(read.parts_at(trajectory, 0.7), rolling[1].parts_at(trajectory, 0.7), strict=True):
        np.testing.assert_allclose(a.means, b.means, atol=1e-6)
