import numpy as np
import pytest
import trimesh

from dwgs.distill.initialize import find_surface, initialize_body
from dwgs.scene import InputError, VehiclePoints
from dwgs.scene.pose import rotation_from_quat
from dwgs.splat.constants import SH_C0

SIZE = np.array([4.0, 1.8, 1.5])


def wall(count=4000, normals=True, is_complete=True, seed=0):
    """The left side of a box: y = 0.9, red."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-2, 2, count), np.full(count, 0.9), rng.uniform(-0.75, 0.75, count)])
    outward = np.tile(np.float32([0, 1, 0]), (count, 1))
    colors = np.tile(np.uint8([255, 0, 0]), (count, 1))
    return VehiclePoints(points.astype(np.float32), colors, outward if normals else None, is_complete)


def discs(vehicle, size, count, eyes):
    return initialize_body(find_surface(vehicle, size), count, eyes)


@pytest.mark.parametrize("normals", [True, False])
def test_discs_lie_flat_on_the_surface(normals):
    body = discs(wall(normals=normals), SIZE, 1000, [])
    thin = rotation_from_quat(body.quats)[np.arange(len(body)), :, body.scales.argmin(1)]
    assert np.abs(thin[:, 1]).min() > 0.99
    assert (body.scales.min(1) < 0.2 * body.scales.max(1)).all()


def test_the_count_is_kept_and_nearly_reached():
    assert 700 <= len(discs(wall(), SIZE, 1000, [])) <= 1000
    assert len(discs(wall(500), SIZE, 1000, [])) == 500


def test_what_no_side_shows_is_left_out():
    half = np.array([1.9, 0.8, 0.7])
    boxes = [trimesh.creation.box(2 * share * half) for share in (1, 0.7)]
    points = np.concatenate([trimesh.sample.sample_surface(box, 40_000, seed=0)[0] for box in boxes])
    vehicle = VehiclePoints(points.astype(np.float32), np.full((len(points), 3), 128, np.uint8), None, True)
    body = discs(vehicle, SIZE, 3000, [])
    is_inner = (np.abs(body.means) < 0.8 * half).all(1)
    assert is_inner.mean() < 0.03  # some show between points of the outer box
    assert len(body) > 2500


def test_colours_are_those_of_the_points():
    body = discs(wall(), SIZE, 1000, [])
    np.testing.assert_allclose(0.5 + SH_C0 * body.sh[:, 0], np.tile([1, 0, 0], (len(body), 1)), atol=1e-6)
    assert (body.sh[:, 1:] == 0).all()


def test_a_scan_of_one_side_is_mirrored_and_a_mesh_is_not():
    scan = discs(wall(is_complete=False), SIZE, 2000, [])
    assert (scan.means[:, 1] < 0).mean() == pytest.approx(0.5, abs=0.05)
    assert (discs(wall(is_complete=True), SIZE, 2000, []).means[:, 1] > 0).all()


def test_what_no_camera_sees_gets_fewer_discs():
    box = trimesh.sample.sample_surface(trimesh.creation.box(SIZE), 40_000, seed=0)[0].astype(np.float32)
    vehicle = VehiclePoints(box, np.full((len(box), 3), 128, np.uint8), None, True)
    body = discs(vehicle, SIZE, 3000, [np.array([0, 9.0, 0])])
    left, right = ((body.means[:, 1] * side > 0.85).sum() for side in (1, -1))
    assert left > 3 * right > 0


def test_points_outside_the_box_are_dropped():
    cloud = wall()
    stray = VehiclePoints(
        np.concatenate([cloud.points, np.float32([[9, 0, 0]])]),
        np.concatenate([cloud.colors, np.uint8([[0, 0, 0]])]),
        is_complete=True,
    )
    assert np.abs(discs(stray, SIZE, 5000, []).means).max() < 2.3


def test_a_single_point_becomes_a_gaussian():
    point = VehiclePoints(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), is_complete=True)
    body = discs(point, SIZE, 100, [])
    assert len(body) == 1
    assert np.isfinite(body.scales).all()


def test_points_that_all_lie_outside_the_box_are_refused():
    with pytest.raises(InputError, match="none of 4000 does; check the unit"):
        discs(wall(), SIZE / 100, 100, [])
