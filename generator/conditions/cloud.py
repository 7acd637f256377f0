"""Coloured points in PLY files, read with no more trust than a stranger's file deserves."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_file
from dwgs.scene import InputError, VehiclePoints

MAX_BYTES = 512 << 20
"""Files larger than this are refused before a byte of them is parsed."""

MAX_POINTS = 1_000_000
"""A cloud of more points is thinned to so many: at 2 mm apart they say nothing new."""

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_MAX_HEADER = 64 << 10


@dataclass(frozen=True)
class PlyHeader:
    """What a PLY file says about itself, checked against the bytes it really has."""

    order: str
    """``<``, ``>``, or empty for text."""
    comments: tuple[str, ...]
    """Comment lines."""
    vertices: int
    """Declared vertices."""
    properties: tuple[tuple[str, str], ...]
    """(name, NumPy type) of each vertex property."""
    faces: int
    """Declared faces."""
    body: int
    """Where the data begins [byte]."""

    @property
    def box(self) -> NDArray[np.float64] | None:
        """[3] (length, width, height) [m] from a comment that holds ``box L W H``; None without one."""
        for comment in self.comments:
            found = re.search(r"box L W H\s+([\d.]+)\s+([\d.]+)\s+([\d.]+)", comment)
            if found:
                return np.array([float(number) for number in found.groups()])
        return None


def read_header(path: Path) -> PlyHeader:
    """The header of a PLY file.

    Raises:
        InputError: It is no PLY file, its vertices hold lists, or it is shorter than it declares.
    """
    path = Path(path)
    with path.open("rb") as file:
        head = file.read(_MAX_HEADER)
    end = re.search(rb"\nend_header[ \t]*\r?\n", head)
    if not head.startswith(b"ply") or end is None:
        raise InputError(f"a PLY file begins with 'ply' and a header of at most 64 KiB, {path.name} does not")
    lines = head[: end.start()].decode("latin-1").splitlines()
    order, element, comments, properties = None, "", [], []
    counts: dict[str, int] = {}
    for words in (line.split() for line in lines[1:]):
        match words:
            case ["format", kind, _] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["comment", *text]:
                comments.append(" ".join(text))
            case ["element", element, count] if count.isdigit():
                if element == "vertex" and counts:
                    raise InputError(f"vertices come first in a PLY file, {path.name} begins with {next(iter(counts))}")
                counts[element] = int(count)
            case ["property", kind, name] if element == "vertex" and kind in _TYPES:
                properties.append((name, _TYPES[kind]))
            case ["property", *_] if element == "vertex":
                raise InputError(f"vertices hold plain numbers, {path.name} declares '{' '.join(words)}'")
    if order is None:
        raise InputError(f"a PLY file is ascii, binary_little_endian or binary_big_endian, {path.name} is neither")
    header = PlyHeader(
        order, tuple(comments), counts.get("vertex", 0), tuple(properties), counts.get("face", 0), end.end()
    )
    # in text a number takes at least a digit and a separator; a face takes at least its length
    row = sum(np.dtype(t).itemsize for _, t in properties) if order else 2 * len(properties)
    least = header.vertices * row + header.faces
    have = path.stat().st_size - header.body
    if least > have + 1:
        raise InputError(
            f"{path.name} declares {header.vertices} vertices and {header.faces} faces, at least {least} "
            f"bytes, but holds {have}; it is cut short or not what it claims"
        )
    return header


def read_cloud(
    path: Path,
) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None, NDArray[np.float64] | None]:
    """Points [P, 3], colours [P, 3] and normals [P, 3] of a PLY file's vertices; None where it has none.

    Raises:
        InputError: The file is broken, empty, or holds points that are not finite.
    """
    path = Path(path)
    header = read_header(path)
    names = [name for name, _ in header.properties]
    if header.vertices == 0:
        raise InputError(f"a vehicle has at least one point, {path.name} is an empty cloud")
    if len(set(names)) != len(names) or not {"x", "y", "z"} <= set(names):
        raise InputError(f"vertices have one x, y and z each, {path.name} declares {', '.join(names) or 'nothing'}")
    with path.open("rb") as file:
        file.seek(header.body)
        if header.order:
            dtype = np.dtype([(name, header.order + kind) for name, kind in header.properties])
            table = np.fromfile(file, dtype, header.vertices)
            columns = {name: table[name] for name in names}
        else:
            try:
                table = np.loadtxt(file, max_rows=header.vertices, ndmin=2, encoding="latin-1")
            except ValueError as error:
                raise InputError(f"vertices of {path.name} are rows of {len(names)} numbers: {error}") from None
            if table.shape != (header.vertices, len(names)):
                raise InputError(f"{path.name} declares {header.vertices} x {len(names)} numbers, has {table.shape}")
            with np.errstate(invalid="ignore"):
                columns = {
                    name: column.astype(kind) for (name, kind), column in zip(header.properties, table.T, strict=True)
                }

    points = np.stack([columns[c] for c in "xyz"], 1).astype(np.float64)
    bad = int((~np.isfinite(points).all(1)).sum())
    if bad:
        raise InputError(f"points are finite, {bad} of {len(points)} in {path.name} are not; remove them")
    colors = None
    for channels in (("red", "green", "blue"), ("r", "g", "b")):
        if set(channels) <= set(names):
            colors = _as_bytes(np.stack([columns[c] for c in channels], 1))
    normals = None
    if {"nx", "ny", "nz"} <= set(names):
        normals = np.stack([columns[c] for c in ("nx", "ny", "nz")], 1).astype(np.float64)
    if len(points) > MAX_POINTS:
        kept = np.sort(np.random.default_rng(0).choice(len(points), MAX_POINTS, replace=False))
        points = points[kept]
        colors = None if colors is None else colors[kept]
        normals = None if normals is None else normals[kept]
    return points, colors, normals


def write_cloud(vehicle: VehiclePoints, path: Path) -> None:
    """Write the points as binary PLY; `read_cloud` returns the same numbers."""
    fields = [(c, "<f4") for c in "xyz"]
    fields += [(c, "<f4") for c in ("nx", "ny", "nz")] if vehicle.normals is not None else []
    fields += [(c, "u1") for c in ("red", "green", "blue")]
    table = np.empty(len(vehicle.points), np.dtype(fields))
    for i, c in enumerate("xyz"):
        table[c] = vehicle.points[:, i]
        if vehicle.normals is not None:
            table["n" + c] = vehicle.normals[:, i]
    for i, c in enumerate(("red", "green", "blue")):
        table[c] = vehicle.colors[:, i]
    words = {"<f4": "float", "u1": "uchar"}
    header = [
        "ply", "format binary_little_endian 1.0", f"element vertex {len(table)}",
        *(f"property {words[kind]} {name}" for name, kind in fields), "end_header",
    ]  # fmt: skip
    with new_file(path) as draft, draft.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode())
        table.tofile(file)


def _as_bytes(colors: NDArray) -> NDArray[np.uint8]:
    """Colours as uint8; floats that stay within [0, 1] are taken as fractions, as most tools write them."""
    if colors.dtype == np.uint8:
        return colors
    colors = np.nan_to_num(np.asarray(colors, np.float64))
    return np.clip(np.rint(colors * (255 if colors.max(initial=0) <= 1 else 1)), 0, 255).astype(np.uint8)
