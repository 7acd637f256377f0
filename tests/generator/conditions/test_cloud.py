from pathlib import Path

import numpy as np
import pytest

from dwgs.scene import InputError, VehiclePoints
from generator.conditions.cloud import read_cloud, read_header, write_cloud

VERTEX = "property float x\nproperty float y\nproperty float z\n"


def ascii_ply(path: Path, properties: str, rows: str, count: int, extra: str = "") -> Path:
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {count}\n{properties}{extra}end_header\n{rows}")
    return path


@pytest.mark.parametrize("with_normals", [True, False])
def test_written_points_read_back_bit_by_bit(tmp_path: Path, with_normals: bool):
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(50, 3)).astype(np.float32) if with_normals else None
    colors = rng.integers(0, 256, (50, 3)).astype(np.uint8)
    vehicle = VehiclePoints(rng.normal(size=(50, 3)).astype(np.float32), colors, normals)
    write_cloud(vehicle, tmp_path / "a.ply")
    points, colors, found = read_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(points.astype(np.float32), vehicle.points)
    np.testing.assert_array_equal(colors, vehicle.colors)
    assert (found is None) == (normals is None)
    if normals is not None:
        np.testing.assert_array_equal(found, normals)


def test_text_big_endian_and_unknown_properties_are_read(tmp_path: Path):
    properties = VERTEX + "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty int extra\n"
    text = ascii_ply(tmp_path / "t.ply", properties, "1 2 3 10 20 30 7\n4 5 6 40 50 60 8\n", 2)
    header = f"ply\nformat binary_big_endian 1.0\nelement vertex 2\n{properties}end_header\n"
    kinds = [("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("r", "u1"), ("g", "u1"), ("b", "u1"), ("e", ">i4")]
    rows = np.array([(1, 2, 3, 10, 20, 30, 7), (4, 5, 6, 40, 50, 60, 8)], kinds)
    big = tmp_path / "b.ply"
    big.write_bytes(header.encode() + rows.tobytes())
    for path in (text, big):
        points, colors, normals = read_cloud(path)
        np.testing.assert_array_equal(points, [[1, 2, 3], [4, 5, 6]])
        np.testing.assert_array_equal(colors, [[10, 20, 30], [40, 50, 60]])
        assert normals is None


def test_the_box_in_a_comment_is_understood(tmp_path: Path):
    path = ascii_ply(tmp_path / "b.ply", VERTEX, "0 0 0\n", 1, "comment box L W H 5.22 2.02 1.89\n")
    np.testing.assert_array_equal(read_header(path).box, [5.22, 2.02, 1.89])


@pytest.mark.parametrize(
    ("count", "rows", "says"),
    [
        (0, "", "empty cloud"),
        (2, "0 0 0\n0 nan 0\n", "points are finite, 1 of 2"),
        (2, "0 0 0\n", "cut short or not what it claims"),
        (10**12, "0 0 0\n", "declares 1000000000000 vertices"),
        (2, "0 0 0\n0 zero 0\n", "rows of 3 numbers"),
    ],
)
def test_a_broken_cloud_is_refused_in_one_sentence(tmp_path: Path, count: int, rows: str, says: str):
    with pytest.raises(InputError, match=says):
        read_cloud(ascii_ply(tmp_path / "a.ply", VERTEX, rows, count))


def test_lists_in_vertices_and_files_of_another_kind_are_refused(tmp_path: Path):
    listed = ascii_ply(tmp_path / "l.ply", "property list uchar int many\n", "1 1\n", 1)
    with pytest.raises(InputError, match="plain numbers"):
        read_cloud(listed)
    other = tmp_path / "o.ply"
    other.write_bytes(b"\x00" * 1000)
    with pytest.raises(InputError, match="begins with 'ply'"):
        read_cloud(other)
