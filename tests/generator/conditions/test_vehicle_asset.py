from pathlib import Path

import numpy as np
import pytest

from dwgs.formats import asset_folder
from dwgs.scene import Gaussians, InputError, VehicleAsset
from generator.conditions.points import load_vehicle


def asset(opacity: float) -> VehicleAsset:
    means = np.array([[0, 0, 0], [1, 0.5, 0.2]], np.float32)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1))
    sh = np.array([[[0.0, 0, 0]], [[9.0, -9, 0]]], np.float32)
    body = Gaussians(means, quats, np.full((2, 3), 0.1, np.float32), np.array([0.2, opacity], np.float32), sh)
    return VehicleAsset(body, Gaussians.empty(), np.array([4.0, 1.8, 1.5]))


def test_the_solid_gaussians_of_an_asset_are_its_points(tmp_path: Path):
    asset_folder.write(asset(0.9), tmp_path / "car")
    vehicle, size, note = load_vehicle(tmp_path / "car")
    np.testing.assert_allclose(vehicle.points, [[1, 0.5, 0.2]])
    np.testing.assert_array_equal(vehicle.colors, [[255, 0, 128]])
    np.testing.assert_array_equal(size, [4.0, 1.8, 1.5])
    assert note == "car: an asset, 1 Gaussians as points"


def test_an_asset_of_mist_and_a_folder_without_one_are_refused(tmp_path: Path):
    asset_folder.write(asset(0.1), tmp_path / "mist")
    with pytest.raises(InputError, match=r"has no Gaussian of opacity over 0\.3"):
        load_vehicle(tmp_path / "mist")
    with pytest.raises(InputError):
        load_vehicle(tmp_path)
