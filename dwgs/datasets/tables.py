"""Pandas tables in gzip pickles, read without pandas and without running anything.

A pickle is a program: it names callables and says with what to call them. Here every callable it may name
is replaced by an inert record of the call: unpickling yields a description of the table, nothing else runs.
The description is then read: layouts of pandas 0.25 to 3, NumPy 1 and 2, pickle protocols 2 to 5.
"""

import gzip
import io
import pickle
import pickletools
import re
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.errors import InputError

MAX_BYTES = 256 * 2**20
"""A table larger than this when unpacked [B] is refused: full sweeps of a spinning LiDAR take 10 MB."""

_KNOWN = {
    "builtins": {"slice", "bytearray"},
    "_codecs": {"encode"},
    "numpy": {"ndarray", "dtype"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.numeric": {"_frombuffer"},
    "numpy._core.numeric": {"_frombuffer"},
    "pandas": {"DataFrame", "Index", "RangeIndex", "StringDtype"},
    "pandas.arrays": {"StringArray"},
    "pandas.core.arrays.string_": {"StringArray", "StringDtype"},
    "pandas.core.frame": {"DataFrame"},
    "pandas.core.indexes.base": {"Index", "_new_Index"},
    "pandas.core.indexes.numeric": {"Int64Index"},
    "pandas.core.indexes.range": {"RangeIndex"},
    "pandas.core.internals.blocks": {"new_block"},
    "pandas.core.internals.managers": {"BlockManager"},
    "pandas._libs.arrays": {"__pyx_unpickle_NDArrayBacked"},
    "pandas._libs.internals": {"_unpickle_block", "BlockPlacement"},
}
"""What a table is made of, by module."""

_NUMERIC = re.compile(r"[iuf][1248]|b1")
_MAX_MEMO = 2**20


def read_table(path: Path) -> dict[str, NDArray]:
    """Columns by name of the gzip-pickled table at ``path``: numbers, or object arrays of plain values.

    Raises `InputError` where the file is missing, broken, unpacks to more than `MAX_BYTES`, or names anything
    that a table does not need; nothing that it names is ever called.
    """
    try:
        with gzip.open(path) as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise InputError(f"there is no table '{path}'; the recording is incomplete") from None
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"'{path}' is not a whole gzip file ({error}); fetch it again") from None
    if len(data) > MAX_BYTES:
        raise InputError(f"'{path}' unpacks to more than {MAX_BYTES >> 20} MB, no table of a recording does; refused")
    try:
        return _columns(_describe(data))
    except _NotATableError as error:
        raise InputError(f"'{path}' {error}; only plain pandas tables are read") from None
    except Exception as error:  # a broken pickle fails in every way there is
        raise InputError(f"'{path}' is not a pickled pandas table ({type(error).__name__}: {error})") from None


class _NotATableError(Exception):
    """Says what the pickle holds that no table needs."""


class _Call:
    """That the pickle called something: with what, and the state it then set. A subclass bears the name."""

    def __init__(self, *args: Any) -> None:
        self.args = args
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    @property
    def name(self) -> str:
        return type(self).__name__


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> type[_Call]:
        if name not in _KNOWN.get(module, ()):
            raise _NotATableError(f"names '{module}.{name}'")
        return type(name, (_Call,), {})


def _describe(data: bytes) -> Any:
    for opcode, argument, _ in pickletools.genops(data):
        # The C unpickler makes room for as many memo entries as the largest number says.
        if "PUT" in opcode.name and argument is not None and argument > _MAX_MEMO:
            raise _NotATableError(f"asks for {argument} memo entries")
    return _Reader(io.BytesIO(data)).load()


def _columns(table: Any) -> dict[str, NDArray]:
    if not isinstance(table, _Call) or table.name != "DataFrame":
        raise _NotATableError("holds no table")
    manager = table.state.get("_mgr", table.state.get("_data"))
    if manager.state is not None:  # pandas < 1.3: (axes, values, items, {"0.14.1": {...}})
        current = manager.state[-1]["0.14.1"]
        axes = current["axes"]
        blocks = [(block["values"], block["mgr_locs"]) for block in current["blocks"]]
    else:
        axes = manager.args[1]
        blocks = [block.args[:2] for block in manager.args[0]]
    names = _array(axes[0].args[1]["data"])
    columns: dict[str, NDArray] = {}
    for values, places in blocks:
        rows = _array(values)
        where = np.arange(len(names))[_places(places)]
        rows = rows.reshape(len(where), -1)  # an extension array is one flat column
        columns |= {str(names[place]): row for place, row in zip(where, rows, strict=True)}
    if len(columns) != len(names) or len({len(column) for column in columns.values()}) > 1:
        raise _NotATableError("holds a table whose columns differ in length")
    return columns


def _places(places: _Call) -> slice | NDArray:
    if places.name == "BlockPlacement":
        places = places.args[0]
    return slice(*places.args) if places.name == "slice" else _array(places)


def _array(call: _Call) -> NDArray:
    if call.name == "__pyx_unpickle_NDArrayBacked":  # a column of strings wraps an array of objects
        return _array(next(part for part in call.state if isinstance(part, _Call) and part.name == "_reconstruct"))
    if call.name == "_frombuffer":
        raw, dtype, shape, order = call.args
    elif call.name == "_reconstruct":
        _, shape, dtype, is_fortran, raw = call.state
        order = "F" if is_fortran else "C"
    else:
        raise _NotATableError(f"keeps values in a '{call.name}'")
    code = dtype.args[0]
    if code.startswith("O"):
        values = np.empty(len(raw), object)
        values[:] = [_value(value) for value in raw]
    elif _NUMERIC.fullmatch(code):
        byte_order = dtype.state[1] if dtype.state else "<"
        values = np.frombuffer(_bytes(raw), np.dtype(code).newbyteorder(byte_order))
    else:
        raise _NotATableError(f"keeps values of type '{code}'")
    return values.reshape(shape, order=order)


def _bytes(raw: Any) -> bytes:
    while isinstance(raw, _Call):  # protocol 2 spells bytes as text: _codecs.encode(text, "latin1")
        raw = raw.args[0]
    return raw.encode("latin1") if isinstance(raw, str) else raw


def _value(value: Any) -> Any:
    if isinstance(value, _Call) and value.name == "scalar" and _NUMERIC.fullmatch(value.args[0].args[0]):
        return np.frombuffer(_bytes(value.args[1]), value.args[0].args[0])[0].item()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise _NotATableError(f"has a cell that holds a {type(value).__name__}")
