import numpy as np
import pytest
from toy_street import CAMERA_AXES

from dwgs.distill.coverage import SECTORS, Coverage
from dwgs.scene import Camera
from dwgs.scene.pose import pose, yaw_rotation
from dwgs.scene.silhouette import box_silhouette

SIZE = np.array([4.0, 2.0, 1.5])
K = np.array([[200.0, 0, 160], [0, 200, 120], [0, 0, 1]])


def seen_from(azimuth, height=0.0, distance=12.0, shown=None):
    """Coverage of one look at a box at the origin, from its own azimuth."""
    position = distance * np.array([np.cos(azimuth), np.sin(azimuth), 0]) + [0, 0, height]
    camera = Camera(K, 320, 240, pose(yaw_rotation(azimuth + np.pi) @ CAMERA_AXES, position), 0.0)
    coverage = Coverage(SIZE)
    coverage.add(camera, np.eye(4), np.ones((240, 320), bool) if shown is None else shown)
    return coverage, camera


@pytest.mark.parametrize(
    ("azimuth", "side", "sector"),
    [(0, "front", 0), (np.pi / 2, "left", 3), (np.pi, "rear", 6), (-np.pi / 2, "right", 9)],
)
def test_each_side_is_counted_where_it_is_seen(azimuth, side, sector):
    report = seen_from(azimuth)[0].report()
    seen = [name for name, pixels in report["side_pixels"].items() if pixels > 0]
    assert seen == [side]
    assert len(report["sectors"]) == SECTORS
    entry = {"azimuth_deg": 30 * sector, "share": 1, "frames": 1, "elevation_deg": [0, 0], "distance_m": [12, 12]}
    assert report["sectors"][sector] == entry
    assert report["sectors"][sector - 1]["distance_m"] is None


def test_sides_add_up_to_the_silhouette():
    coverage, camera = seen_from(0.7, height=3.0)
    pixels = box_silhouette(camera, np.eye(4), SIZE).sum()
    assert sum(coverage.side_pixels.values()) == pytest.approx(pixels, rel=0.02)
    assert coverage.side_pixels["top"] > 0


def test_what_is_not_shown_does_not_count():
    coverage, _ = seen_from(0.7, shown=np.zeros((240, 320), bool))
    assert sum(coverage.side_pixels.values()) == 0
    assert sum(entry["share"] for entry in coverage.report()["sectors"]) == 0
