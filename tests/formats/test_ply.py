import contextlib
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dwgs.formats import ply
from dwgs.scene import Gaussians, InputError
from dwgs.scene.gaussians import SH_COUNTS

in_one_folder = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
"""Examples overwrite each other's file, which is what writing in place is for."""


def floats(low, high, **options):
    return st.floats(np.float32(low).item(), np.float32(high).item(), width=32, **options)


@st.composite
def clouds(draw):
    n, count = draw(st.integers(0, 5)), draw(st.sampled_from(SH_COUNTS))
    quats = draw(arrays(np.float32, (n, 4), elements=floats(-1, 1))) + np.float32([0, 0, 0, 2])
    return Gaussians(
        means=draw(arrays(np.float32, (n, 3), elements=floats(-1e30, 1e30))),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=draw(arrays(np.float32, (n, 3), elements=floats(0, 1e30))),
        opacities=draw(arrays(np.float32, n, elements=floats(0, 1))),
        sh=draw(arrays(np.float32, (n, count, 3), elements=floats(-1e30, 1e30))),
    )


def some(n=7, degree=3, seed=0) -> Gaussians:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(n, 4))
    return Gaussians(
        rng.normal(size=(n, 3)).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        np.exp(rng.normal(-3, 1, (n, 3))).astype(np.float32),
        rng.uniform(size=n).astype(np.float32),
        rng.normal(size=(n, SH_COUNTS[degree], 3)).astype(np.float32),
    )


def columns_of(path) -> dict[str, np.ndarray]:
    """The table of a file of ours, read without our reader."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return dict(zip(names, table.T, strict=True))


def foreign(path, columns, byte_order="<", types=None, before=(), after=()):
    """What another program could write: any order of properties, any types, elements around the vertices."""
    types = types or {}
    letters = {"f4": "float", "f8": "double", "i2": "short", "u1": "uchar"}
    kinds = {name: types.get(name, "f4") for name in columns}
    count = len(next(iter(columns.values())))
    name = {"<": "binary_little_endian", ">": "binary_big_endian", "": "ascii"}[byte_order]
    lines = ["ply", f"format {name} 1.0", "comment made elsewhere", *before, f"element vertex {count}"]
    lines += [f"property {letters[kind]} {column}" for column, kind in kinds.items()]
    lines += [*after, "end_header"]
    table = np.zeros(count, [(column, byte_order + kind) for column, kind in kinds.items()])
    for column, values in columns.items():
        table[column] = values
    body = b"".join((" ".join(map(repr, row)) + "\n").encode() for row in table.tolist())
    path.write_bytes(("\n".join(lines) + "\n").encode() + (table.tobytes() if byte_order else body))


def assert_equal(a: Gaussians, b: Gaussians, **tolerance):
    for field in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(a, field), getattr(b, field), err_msg=field, **tolerance)


@in_one_folder
@given(clouds())
def test_writing_what_was_read_gives_the_same_bytes(tmp_path, cloud):
    ply.write(cloud, tmp_path / "a.ply")
    ply.write(ply.read(tmp_path / "a.ply"), tmp_path / "b.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@in_one_folder
@given(clouds())
def test_what_is_read_is_what_was_written_up_to_rounding(tmp_path, cloud):
    ply.write(cloud, tmp_path / "a.ply")
    read = ply.read(tmp_path / "a.ply")
    for exact in ("means", "quats", "sh"):
        np.testing.assert_array_equal(getattr(read, exact), getattr(cloud, exact))
    np.testing.assert_allclose(read.scales, cloud.scales, rtol=1e-5, atol=1e-44)
    np.testing.assert_allclose(read.opacities, cloud.opacities, rtol=1e-5, atol=1e-44)


def test_values_settle_at_every_exponent(tmp_path):
    x = np.unique(np.exp(np.linspace(-80, 0, 200_001)).astype(np.float32))
    for scales, opacities in ((x, x), (1 / x, 1 - x)):
        n = len(x)
        flat = np.zeros((n, 1, 3), np.float32)
        cloud = Gaussians(flat[:, 0], np.eye(4, dtype="f4")[[0] * n], scales[:, None] + flat[:, 0], opacities, flat)
        ply.write(cloud, tmp_path / "a.ply")
        ply.write(ply.read(tmp_path / "a.ply"), tmp_path / "b.ply")
        assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_invisible_and_opaque_survive(tmp_path):
    cloud = some(4)
    opacities = np.array([0, 1, 1 - 2**-24, 1e-45], np.float32)
    ply.write(Gaussians(cloud.means, cloud.quats, cloud.scales, opacities, cloud.sh), tmp_path / "a.ply")
    np.testing.assert_array_equal(ply.read(tmp_path / "a.ply").opacities, opacities)
    assert np.isfinite(columns_of(tmp_path / "a.ply")["opacity"]).all()


def test_the_file_holds_what_splat_viewers_expect(tmp_path):
    cloud = some(3, degree=2)
    ply.write(cloud, tmp_path / "a.ply")
    lines = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0].decode().splitlines()
    assert lines[:4] == [
        "ply",
        "format binary_little_endian 1.0",
        "comment dwgs_frame FLU",
        "element vertex 3",
    ]
    columns = columns_of(tmp_path / "a.ply")
    rest = [f"f_rest_{i}" for i in range(24)]
    wxyz, xyz = ["rot_0", "rot_1", "rot_2", "rot_3"], ["scale_0", "scale_1", "scale_2"]
    dc = ["f_dc_0", "f_dc_1", "f_dc_2"]
    assert list(columns) == ["x", "y", "z", "nx", "ny", "nz", *dc, *rest, "opacity", *xyz, *wxyz]
    np.testing.assert_array_equal(columns["f_rest_8"], cloud.sh[:, 1, 1])  # all of red, then green begins
    np.testing.assert_allclose(np.exp(columns["scale_1"]), cloud.scales[:, 1], rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-columns["opacity"])), cloud.opacities, rtol=1e-5)
    np.testing.assert_array_equal(columns["rot_0"], cloud.quats[:, 0])


@pytest.mark.parametrize("byte_order", ["<", ">", ""])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_properties_are_found_by_name_in_any_order_and_byte_order(tmp_path, byte_order, degree):
    cloud = some(5, degree)
    ply.write(cloud, tmp_path / "ours.ply")
    columns = columns_of(tmp_path / "ours.ply")
    names = [name for name in reversed(columns) if name[0] != "n"]  # and without normals
    types = {"x": "f8", "opacity": "f8", "extra": "u1"}
    shuffled = {"extra": np.arange(5), **{name: columns[name] for name in names}}
    foreign(tmp_path / "theirs.ply", shuffled, byte_order, types)
    assert_equal(ply.read(tmp_path / "theirs.ply"), ply.read(tmp_path / "ours.ply"), rtol=0)


def test_elements_around_the_vertices_are_skipped(tmp_path):
    cloud = some(2)
    ply.write(cloud, tmp_path / "ours.ply")
    columns = columns_of(tmp_path / "ours.ply")
    before = ["element view 3", "property double a", "property uchar b"]
    foreign(tmp_path / "theirs.ply", columns, before=before, after=["element last 9", "property float c"])
    data = (tmp_path / "theirs.ply").read_bytes()
    at = data.index(b"end_header\n") + len(b"end_header\n")
    (tmp_path / "theirs.ply").write_bytes(data[:at] + bytes(27) + data[at:] + bytes(36))
    assert_equal(ply.read(tmp_path / "theirs.ply"), ply.read(tmp_path / "ours.ply"), rtol=0)


def test_rotations_of_any_length_are_read_as_unit(tmp_path):
    cloud = some(4)
    ply.write(cloud, tmp_path / "ours.ply")
    columns = columns_of(tmp_path / "ours.ply")
    longer = {name: values * (7 if name[:3] == "rot" else 1) for name, values in columns.items()}
    foreign(tmp_path / "theirs.ply", longer)
    np.testing.assert_allclose(ply.read(tmp_path / "theirs.ply").quats, cloud.quats, atol=1e-7)


def test_a_count_beyond_the_file_is_refused_before_memory_is_taken(tmp_path):
    ply.write(some(2), tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    for count in (3, 10**12, 10**40):
        (tmp_path / "b.ply").write_bytes(data.replace(b"vertex 2\n", b"vertex %d\n" % count))
        tracemalloc.start()
        with pytest.raises(InputError, match=r"promises|no use for"):
            ply.read(tmp_path / "b.ply")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"ply\n", b"plx\n", "not a PLY file"),
        (b"end_header", b"and_header", "not a PLY file"),
        (b"binary_little_endian", b"binary_middle_endian", "not a PLY file"),
        (b"float x", b"float q", "lacks x"),
        (b"float f_rest_44", b"float g_rest_44", "44 f_rest"),
        (b"float nx", b"float x", "twice"),
        (b"property float nx", b"property list uchar int nx", "no use for"),
        (b"element vertex", b"element vortex", "without vertices"),
        (b"dwgs_frame FLU", b"dwgs_frame RDF", "axes 'RDF'"),
    ],
)
def test_a_file_of_something_else_is_refused_in_one_sentence(tmp_path, old, new, message):
    ply.write(some(2), tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes((tmp_path / "a.ply").read_bytes().replace(old, new))
    with pytest.raises(InputError, match=message):
        ply.read(tmp_path / "a.ply")


@pytest.mark.parametrize("column", ["x", "opacity", "scale_2", "rot_1", "f_dc_0", "f_rest_7"])
def test_nan_in_a_file_is_refused(tmp_path, column):
    ply.write(some(3), tmp_path / "a.ply")
    columns = {name: values.copy() for name, values in columns_of(tmp_path / "a.ply").items()}
    columns[column][1] = np.nan
    foreign(tmp_path / "b.ply", columns)
    with pytest.raises(InputError, match="of 1 of 3"):
        ply.read(tmp_path / "b.ply")


def test_nan_is_not_written_and_the_former_file_stays(tmp_path):
    ply.write(some(3), tmp_path / "a.ply")
    before = (tmp_path / "a.ply").read_bytes()
    cloud = some(3)
    cloud.means[1, 0] = np.nan
    with pytest.raises(InputError, match="finite"):
        ply.write(cloud, tmp_path / "a.ply")
    assert (tmp_path / "a.ply").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


@in_one_folder
@given(st.data())
def test_damaged_files_are_read_or_refused_but_never_anything_else(tmp_path, data):
    ply.write(some(2, degree=0), tmp_path / "a.ply")
    damaged = bytearray((tmp_path / "a.ply").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "a.ply").write_bytes(damaged[: data.draw(st.integers(0, len(damaged)))])
    with contextlib.suppress(InputError):
        ply.read(tmp_path / "a.ply")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.ply"):
        ply.read(tmp_path / "nothing.ply")
