"""Real vehicles, as people have them. Skipped where the data is absent."""

from pathlib import Path

import numpy as np
import pytest

from generator.conditions import mesh as mesh_module
from generator.conditions.points import load_vehicle

DATA = Path(__file__).parents[3].parent / "shared" / "data"
pytestmark = pytest.mark.skipif(not DATA.exists(), reason=f"REAL DATA MISSING: no {DATA}, real vehicles are untested")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_module, "SAMPLES", 1 << 15)


def test_a_car_in_gltf_stands_on_its_wheels_and_looks_forward():
    vehicle, size, note = load_vehicle(DATA / "mesh-prius" / "prius.glb")
    np.testing.assert_allclose(size, [4.618, 2.012, 1.530], atol=1e-3)
    assert note.endswith("metres (4.62 x 2.01 x 1.53 m), up +y, forward +z")
    red = vehicle.points[vehicle.colors[:, 0].astype(int) - vehicle.colors[:, 1] > 60]
    assert (red[:, 0] < -1.5).sum() > (red[:, 0] > 1.5).sum()  # lights at the rear
    assert vehicle.colors[vehicle.points[:, 2] > 0.72].mean() > 150  # a white roof


def test_a_body_in_centimetres_without_wheels_is_understood_and_said():
    _, size, note = load_vehicle(DATA / "mesh-prius" / "hybrid_body.obj")
    np.testing.assert_allclose(size, [4.618, 2.012, 1.530], atol=1e-3)
    assert "centimetres" in note
    assert "forward -y (unit and forward assumed" in note
    assert "14 cm above its own zero" in note


def test_a_truck_whose_length_is_not_where_its_format_says_is_understood():
    _, size, note = load_vehicle(DATA / "mesh-milktruck" / "CesiumMilkTruck.glb")
    np.testing.assert_allclose(size, [4.869, 2.792, 2.583], atol=1e-3)
    assert "forward +x (forward assumed" in note


def test_a_scan_that_states_its_box_keeps_its_frame():
    vehicle, size, note = load_vehicle(DATA / "vehicle-points-pandaset" / "pickup_7ed5e06e.ply")
    np.testing.assert_array_equal(size, [5.224, 2.022, 1.889])
    assert len(vehicle.points) > 60_000
    assert "states its box" in note
    assert not vehicle.is_complete
