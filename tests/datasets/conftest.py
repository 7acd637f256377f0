"""PandaSet folders made of nothing: tables pickled as pandas would, without pandas."""

import gzip
import json
import pickle
import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

WriteTable = Callable[..., None]


class _Reduced:
    """Pickles as the call of ``function`` with ``args``, then ``state``."""

    def __init__(self, function, args, state=None):
        self.parts = (function, args) if state is None else (function, args, state)

    def __reduce__(self):
        return self.parts


@pytest.fixture
def write_table(monkeypatch: pytest.MonkeyPatch) -> WriteTable:
    """``write_table(path, columns, layout)``: layout "0.25", "2" or "3" of pandas."""

    def stand_in(module: str, name: str):
        if module not in sys.modules:
            monkeypatch.setitem(sys.modules, module, types.ModuleType(module))
        made = type(name, (), {"__module__": module, "__qualname__": name})
        setattr(sys.modules[module], name, made)
        return made

    names = {
        "pandas": ("DataFrame", "Index", "RangeIndex", "StringDtype"),
        "pandas.arrays": ("StringArray",),
        "pandas.core.frame": ("DataFrame",),
        "pandas.core.indexes.base": ("Index", "_new_Index"),
        "pandas.core.indexes.range": ("RangeIndex",),
        "pandas.core.internals.managers": ("BlockManager",),
        "pandas._libs.arrays": ("__pyx_unpickle_NDArrayBacked",),
        "pandas._libs.internals": ("_unpickle_block",),
    }
    made = {(module, name): stand_in(module, name) for module, many in names.items() for name in many}
    new_index = made["pandas.core.indexes.base", "_new_Index"]

    def strings(values: np.ndarray):
        dtype = _Reduced(made["pandas", "StringDtype"], ("python", np.nan))
        call = (made["pandas.arrays", "StringArray"], 82904607, None)
        return _Reduced(made["pandas._libs.arrays", "__pyx_unpickle_NDArrayBacked"], call, (dtype, values))

    def axes(labels: list[str], rows: int, layout: str):
        data = np.array(labels, object)
        index = made["pandas", "Index"]
        return [
            _Reduced(new_index, (index, {"data": strings(data) if layout == "3" else data, "name": None})),
            _Reduced(new_index, (made["pandas", "RangeIndex"], {"start": 0, "stop": rows, "step": 1})),
        ]

    def write(path: Path, columns: dict[str, np.ndarray], layout: str = "3") -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = [np.asarray(values) for values in columns.values()]
        arrays = [a.astype(object) if a.dtype.kind == "U" else a for a in arrays]
        where = axes(list(columns), len(arrays[0]), layout)
        if layout == "0.25":
            blocks = [{"values": a[None], "mgr_locs": np.array([i])} for i, a in enumerate(arrays)]
            manager = made["pandas.core.internals.managers", "BlockManager"]
            state = (where, [], [], {"0.14.1": {"axes": where, "blocks": blocks}})
            content = {"_data": _Reduced(manager, (), state), "_typ": "dataframe"}
        else:
            unpickle = made["pandas._libs.internals", "_unpickle_block"]
            blocks = tuple(
                _Reduced(unpickle, (strings(a), slice(i, i + 1, 1), 1))
                if a.dtype == object and layout == "3"
                else _Reduced(unpickle, (a[None], slice(i, i + 1, 1), 2))
                for i, a in enumerate(arrays)
            )
            manager = made["pandas.core.internals.managers", "BlockManager"]
            content = {"_mgr": _Reduced(manager, (blocks, where)), "_typ": "dataframe", "attrs": {}}
        table = _Reduced(made["pandas.core.frame", "DataFrame"], (), content)
        protocol = {"0.25": 2, "2": 4, "3": 5}[layout]
        path.write_bytes(gzip.compress(pickle.dumps(table, protocol)))

    return write


FRAMES = range(3, 8)
"""Frames of the made-up recording that the folder holds; stamps and poses go on to frame 9."""
START = 1557539956.5
CAR_SPEED = 5.0


@pytest.fixture
def pandaset_folder(tmp_path: Path, write_table: WriteTable) -> Path:
    """A recording at 10 Hz that drives along world +y at 2 m/s; frame 5 has no sweep.

    A car at x = -3 drives along +y at 5 m/s; its points are hit 40 ms before the end of the sweep, and the
    other LiDAR has boxes of its own for it. A parked car stands at x = 4.
    """
    root = tmp_path / "042"
    stamps = START + 0.1 * np.arange(10)

    def poses(positions, quat):
        heading = dict(zip("wxyz", quat, strict=True))
        return [{"position": dict(zip("xyz", map(float, p), strict=True)), "heading": heading} for p in positions]

    def write_json(path: Path, content) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))

    ego = np.stack([np.zeros(10), 2 * (stamps - START), np.zeros(10)], 1)
    write_json(root / "lidar/poses.json", poses(ego, (1, 0, 0, 0)))
    write_json(root / "lidar/timestamps.json", stamps.tolist())
    half = np.sqrt(0.5)
    for name in ("left_camera", "front_camera"):
        folder = root / "camera" / name
        # x right, y down, z forward = world +y: a quarter turn about x
        write_json(folder / "poses.json", poses(ego + np.array([0, 0, 1.8]), (half, -half, 0.0, 0.0)))
        write_json(folder / "timestamps.json", (stamps - 0.05).tolist())
        write_json(folder / "intrinsics.json", {"fx": 50.0, "fy": 50.0, "cx": 31.5, "cy": 23.5})
        for n in FRAMES:
            Image.new("RGB", (64, 48), (10 * n, 100, 200)).save(folder / f"{n:02}.jpg")
    classes = {"4": "Reflection", "5": "Vegetation", "7": "Road", "13": "Car"}
    write_json(root / "annotations/semseg/classes.json", classes)

    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-20, 20, (4000, 2)), np.zeros(4000)])
    for n in FRAMES:
        hit = stamps[n] - 0.04
        car = (-3, CAR_SPEED * (hit - START), 0.75)
        twin = (-3, CAR_SPEED * (stamps[n] - START), 0.75)
        surface = car + rng.uniform(-0.5, 0.5, (50, 3)) * (1.8, 4.4, 1.4)
        points = np.concatenate([ground, surface, [[np.nan, 0, 0]]])
        times = np.concatenate([np.full(len(ground), stamps[n] - 0.01), np.full(50, hit), [hit]])
        table = {axis: points[:, i] for i, axis in enumerate("xyz")} | {
            "t": times,
            "d": np.zeros(len(times), int),
        }
        if n != 5:
            write_table(root / f"lidar/{n:02}.pkl.gz", table)
            classes = np.concatenate([np.full(len(ground), 7), np.full(50, 13), [4]])
            write_table(root / f"annotations/semseg/{n:02}.pkl.gz", {"class": classes})
        centres = np.array([car, twin, (4, 5, 0.75)])
        boxes = {
            "uuid": np.array(["aaaa-car", "bbbb-twin", "cccc-parked"]),
            "label": np.array(["Car", "Car", "Car"]),
            "yaw": np.zeros(3),
            "stationary": np.array([False, False, True]),
            "camera_used": np.array([-1, -1, -1]),
            **{f"position.{axis}": centres[:, i] for i, axis in enumerate("xyz")},
            "dimensions.x": np.array([1.9, 2.0, 1.9]),
            "dimensions.y": np.array([4.5, 4.6, 4.5]),
            "dimensions.z": np.full(3, 1.5),
            "cuboids.sibling_id": np.array(["bbbb-twin", "aaaa-car", "-"]),
            "cuboids.sensor_id": np.array([0, 1, -1]),
        }
        write_table(root / f"annotations/cuboids/{n:02}.pkl.gz", boxes, "0.25")
    return root
