"""Gaussians in a PLY file as every splat viewer reads it.

Names, order and activations are those of the reference implementation of "3D Gaussian Splatting" (Kerbl et
al., 2023): opacity as a logit, scales as logarithms, rotations wxyz, higher harmonics channel by channel. Our
own addition is one header comment that names the axes.

Writing what was read gives the same bytes again, because log and exp run in float64 and round once: of a
value and its logarithm, the coarser one in float32 survives the way there and back. Unit quaternions are kept
to the bit.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_file
from dwgs.scene import Gaussians, InputError
from dwgs.scene.gaussians import SH_COUNTS

AXES = "FLU"
"""Forward, left, up: x, y, z of a vehicle; of a world, only that z is up."""
RAW_RANGE = (-110.0, 20.0)
"""Finite stand-ins for log 0, logit 0 and logit 1: in float32, exp(-110) is 0 and sigmoid(20) is 1."""

_MEANS, _QUATS, _SCALES = ["x", "y", "z"], [f"rot_{i}" for i in range(4)], [f"scale_{i}" for i in range(3)]
_DC = [f"f_dc_{i}" for i in range(3)]
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 16


def write(gaussians: Gaussians, path: Path) -> None:
    """Write ``gaussians`` whole or not at all; `InputError` where they are not finite or out of range."""
    _check(gaussians, path)
    count = len(gaussians)
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(count, 3 * (gaussians.sh.shape[1] - 1))
    table = np.concatenate(
        [
            gaussians.means,
            np.zeros((count, 3)),
            gaussians.sh[:, 0],
            rest,
            _logit(gaussians.opacities)[:, None],
            _log(gaussians.scales),
            _unit(gaussians.quats),
        ],
        axis=1,
        dtype="<f4",
        casting="same_kind",
    )
    names = [*_MEANS, "nx", "ny", "nz", *_DC, *_rest(rest.shape[1]), "opacity", *_SCALES, *_QUATS]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment dwgs_frame {AXES}",
        f"element vertex {count}",
    ]
    header += [*(f"property float {name}" for name in names), "end_header"]
    with new_file(path) as draft, draft.open("wb") as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        stream.write(table.tobytes())


def read(path: Path) -> Gaussians:
    """Gaussians of a PLY file by any writer: properties are found by name, in any order, type and byte order.

    Normals and unknown properties are ignored; the count of ``f_rest`` gives the SH degree, 0 to 3.
    Raises `InputError` for a file that is missing, cut short, no PLY, or lacks a property, or is not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"'{path}' is not a file; name a PLY file of Gaussians")
    with path.open("rb") as stream:
        header = _read_header(stream, path)
        names = header.dtype.names or ()
        rest = _rest(sum(name.startswith("f_rest_") for name in names))
        needed = [*_MEANS, *_DC, *rest, "opacity", *_SCALES, *_QUATS]
        if missing := [name for name in needed if name not in names]:
            raise InputError(
                f"'{path}' lacks {', '.join(missing)}: it has no Gaussians or packed ones; convert it first"
            )
        if len(rest) not in [3 * (k - 1) for k in SH_COUNTS]:
            raise InputError(f"'{path}' has {len(rest)} f_rest properties; degrees 0 to 3 have 0, 9, 24 or 45")
        columns = _read_columns(stream, header, path)

    def gather(names: list[str]) -> NDArray[np.float32]:
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite and is refused below
            return np.stack([columns[name].astype(np.float32) for name in names], -1)

    dc = gather(_DC)[:, None]
    higher = [gather(rest).reshape(len(dc), 3, len(rest) // 3).transpose(0, 2, 1)] if rest else []
    gaussians = Gaussians(
        means=gather(_MEANS),
        quats=_unit(gather(_QUATS)),
        scales=_exp(gather(_SCALES)),
        opacities=_sigmoid(gather(["opacity"])[:, 0]),
        sh=np.concatenate([dc, *higher], axis=1),
    )
    _check(gaussians, path)
    return gaussians


@dataclass(frozen=True)
class _Header:
    """What the file says follows, up to its vertices."""

    byte_order: str
    """"<", ">", or "" for text."""
    rows_before: int
    """Rows of other elements ahead of the vertices."""
    bytes_before: int
    """Their size in a binary file."""
    count: int
    """Vertices."""
    dtype: np.dtype
    """One vertex."""


def _read_header(stream: BinaryIO, path: Path) -> _Header:
    head = stream.read(_LONGEST_HEADER)
    text, found, _ = head.partition(b"\nend_header")
    end = head.find(b"\n", len(text) + 1) + 1
    lines = [line.split() for line in text.decode("ascii", "replace").splitlines()]
    byte_order = next((_BYTE_ORDERS.get(line[1]) for line in lines if line[:1] == ["format"] and line[1:]), None)
    if not found or not end or lines[:1] != [["ply"]] or byte_order is None:
        raise InputError(f"'{path}' is not a PLY file: it lacks the header of one")
    stream.seek(end)

    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for line in lines:
        match line:
            case ["comment", "dwgs_frame", axes] if axes != AXES:
                raise InputError(f"'{path}' is in axes '{axes}', Gaussians here are in {AXES}; convert it first")
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append((name, int(count), []))
            case ["property", type_name, name] if type_name in _TYPES and elements:
                elements[-1][2].append((name, byte_order + _TYPES[type_name]))
            case ["element" | "property", *_]:
                raise InputError(f"'{path}' has a header line that Gaussians have no use for: '{' '.join(line)[:80]}'")
    names = [name for name, _, _ in elements]
    if "vertex" not in names:
        raise InputError(f"'{path}' is a PLY file without vertices, so without Gaussians")
    before, (_, count, properties) = elements[: names.index("vertex")], elements[names.index("vertex")]
    if len(dict(properties)) != len(properties):
        raise InputError(f"'{path}' names a property of its vertices twice")
    sizes = [rows * sum(np.dtype(kind).itemsize for _, kind in fields) for _, rows, fields in before]
    return _Header(byte_order, sum(rows for _, rows, _ in before), sum(sizes), count, np.dtype(properties))


def _read_columns(stream: BinaryIO, header: _Header, path: Path) -> dict[str, NDArray]:
    names = header.dtype.names or ()
    is_text = not header.byte_order
    row = 2 * len(names) if is_text else header.dtype.itemsize  # a number in text: a digit and what parts it
    needed = header.count * row + (0 if is_text else header.bytes_before)
    there = path.stat().st_size - stream.tell()
    if needed > there + is_text:  # the last digit may end the file
        raise InputError(
            f"'{path}' promises {header.count} Gaussians, at least {needed} bytes, "
            f"but {there} bytes follow its header; it was cut short or is corrupt"
        )
    if not is_text:
        stream.seek(header.bytes_before, 1)
        table = np.fromfile(stream, header.dtype, header.count)
        return {name: table[name] for name in names}
    try:
        rows = [line.split() for line in stream.read().decode("ascii").splitlines()[header.rows_before :]]
        values = np.array(rows[: header.count], np.float64).reshape(header.count, len(names))
    except ValueError as error:
        raise InputError(f"'{path}' is a text PLY whose lines do not match its header; it is corrupt") from error
    return dict(zip(names, values.T, strict=True))


def _check(gaussians: Gaussians, path: Path) -> None:
    for name in ("means", "quats", "scales", "opacities", "sh"):
        values = getattr(gaussians, name)
        bad = int((~np.isfinite(values)).any(tuple(range(1, values.ndim))).sum())
        if bad:
            raise InputError(f"Gaussians are finite, but {name} of {bad} of {len(gaussians)} for '{path}' are not")
    if (gaussians.scales < 0).any() or (gaussians.opacities < 0).any() or (gaussians.opacities > 1).any():
        raise InputError(f"scales are positive and opacities lie in [0, 1]; for '{path}' they do not")


def _rest(count: int) -> list[str]:
    return [f"f_rest_{i}" for i in range(count)]


def _unit(quats: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quaternions [N, 4] of length one; those that already are, up to rounding, stay as they are."""
    quats = np.asarray(quats, np.float32)
    length = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):  # of no length: not finite, and refused
        return np.where(abs(length - 1) < 1e-6, quats, (quats / length).astype(np.float32))


def _logit(opacities: NDArray[np.float32]) -> NDArray[np.float32]:
    o = opacities.astype(np.float64)
    with np.errstate(divide="ignore"):
        return np.clip(np.log(o) - np.log1p(-o), *RAW_RANGE).astype(np.float32)


def _sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(over="ignore", under="ignore"):
        return (1 / (1 + np.exp(-logits.astype(np.float64)))).astype(np.float32)


def _log(scales: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(divide="ignore"):
        return np.maximum(np.log(scales.astype(np.float64)), RAW_RANGE[0]).astype(np.float32)


def _exp(logs: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(over="ignore", under="ignore"):
        return np.exp(logs.astype(np.float64)).astype(np.float32)
