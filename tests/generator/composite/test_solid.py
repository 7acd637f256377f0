import numpy as np
import pytest
import trimesh

from dwgs.scene import Camera, VehiclePoints
from dwgs.scene.pose import pose
from generator.composite.raster import draw, facing
from generator.composite.solid import concave_majorant, solid_from_scan
from generator.composite.surface import surface_of

SIZE = np.array([4.4, 1.8, 1.5])


def one_sided_scan(count=20_000):
    """The left side, the left of the roof and the rear of a box-shaped car; a window, and nothing low down."""
    rng = np.random.default_rng(0)
    side = rng.uniform([-2.2, 0.9, -0.6], [2.2, 0.9, 0.75], (count, 3))
    window = (np.abs(side[:, 0]) < 0.6) & (side[:, 2] > 0.15) & (side[:, 2] < 0.6)
    seats = side[window] - (0, 0.5, 0)
    roof = rng.uniform([-2.2, 0.2, 0.75], [2.2, 0.9, 0.75], (count // 4, 3))
    rear = rng.uniform([-2.2, -0.9, -0.5], [-2.2, 0.9, 0.75], (count // 4, 3))
    return np.concatenate([side[~window], seats[::4], roof, rear])


def view(eye):
    z = -np.asarray(eye, float) / np.linalg.norm(eye)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    K = np.array([[220.0, 0, 96], [0, 220, 64], [0, 0, 1]])
    return Camera(K, 192, 128, pose(np.stack([x, np.cross(z, x), z], 1), eye), 0.0)


@pytest.fixture(scope="module")
def solid():
    return solid_from_scan(one_sided_scan(), SIZE)


def test_a_one_sided_scan_becomes_a_watertight_solid_of_the_boxs_size(solid):
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    assert mesh.is_watertight
    assert np.allclose(np.ptp(solid.vertices, 0), SIZE, atol=0.12)


def test_a_window_that_returned_nothing_is_bridged(solid):
    near = np.abs(solid.vertices[:, [0, 2]] - (0, 0.35)).max(1) < 0.1
    assert np.abs(np.abs(solid.vertices[near, 1]) - 0.9).max() < 0.06


def test_the_unseen_side_is_the_mirror_image_of_the_seen_one(solid):
    left, right = solid.vertices[:, 1].max(), -solid.vertices[:, 1].min()
    assert left == pytest.approx(right, abs=1e-3)


def test_wheels_reach_the_ground(solid):
    assert solid.vertices[:, 2].min() == pytest.approx(-SIZE[2] / 2, abs=0.02)
    assert len(solid.wheels) == 2


@pytest.fixture(scope="module")
def surface():
    points = one_sided_scan().astype(np.float32)
    return surface_of(VehiclePoints(points, np.full(points.shape, 90, np.uint8)), SIZE)


@pytest.mark.parametrize("eye", [(-7, 4, 1.5), (7, -4, 1.5), (0, -8, 1.0)])
def test_the_silhouette_of_a_one_sided_scan_has_no_holes(surface, eye):
    camera = view(eye)
    seen = facing(surface, camera, np.eye(4))
    _, _, coverage = draw(surface, seen, surface.colors[seen], camera, np.eye(4))
    middle, _ = camera.project([[x, y, z] for x in (-1.5, 0, 1.5) for y in (-0.6, 0.6) for z in (-0.3, 0, 0.5)])
    column, row = middle.astype(int).T
    assert (coverage[row, column] > 0.99).all()


def test_the_concave_majorant_lies_above_every_point():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1, 200), rng.uniform(0, 1, 200)
    knots = concave_majorant(x, y)
    assert (np.interp(x, knots[:, 0], knots[:, 1]) >= y - 1e-12).all()
    assert (np.diff(np.diff(knots[:, 1]) / np.diff(knots[:, 0])) <= 1e-9).all()
