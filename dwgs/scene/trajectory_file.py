"""Trajectories as people and simulators write them: JSON or CSV.

JSON, poses as matrices or as positions and quaternions (w, x, y, z)::

    {"times": [0.0, 0.1], "world_from_vehicle": [[[1, 0, 0, 5], ...], ...], "reference": "box_center"}
    {"times": [0.0, 0.1], "positions": [[5, 0, 0.75], ...], "quaternions": [[1, 0, 0, 0], ...]}

CSV, angles in radians after ISO 8855 (heading about z, then pitch about y, then roll about x)::

    # reference: ground_center
    t,x,y,z,heading,pitch,roll
    0.0,5.0,0.0,0.0,0.0,0.0,0.0

``reference`` names the point of the vehicle that the poses are of: ``box_center`` (where nothing is said) or
``ground_center``, below it on the ground.
"""

import csv
import json
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.files import new_file
from dwgs.scene.errors import InputError
from dwgs.scene.pose import pose, rotation_from_quat, yaw_rotation
from dwgs.scene.trajectory import Trajectory

REFERENCES = ("box_center", "ground_center")

_COLUMNS = ("t", "x", "y", "z", "heading")
_OPTIONAL_COLUMNS = ("pitch", "roll")


def read_trajectory(path: Path, size: ArrayLike) -> Trajectory:
    """The trajectory in a ``.json`` or ``.csv`` file, as poses of the box centre.

    ``size`` is the vehicle's (length, width, height) [m]: it leads from the ground to the box centre. Raises
    `InputError` saying what in the file breaks which rule.
    """
    path = Path(path)
    readers = {".json": _read_json, ".csv": _read_csv}
    if path.suffix.lower() not in readers:
        raise InputError(f"a trajectory is a .json or a .csv file, got '{path}'")
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"there is no trajectory '{path}'") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"'{path}' cannot be read as text ({error})") from None
    try:
        times, world_from_reference, reference = readers[path.suffix.lower()](text)
        if reference not in REFERENCES:
            raise InputError(f"the reference is {' or '.join(REFERENCES)}, not '{reference}'")
        reference_from_vehicle = np.eye(4)
        if reference == "ground_center":
            reference_from_vehicle[2, 3] = np.asarray(size, np.float64)[2] / 2
        return Trajectory(times, world_from_reference @ reference_from_vehicle)
    except InputError as error:
        raise InputError(f"'{path}': {error}") from None


def write_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write the poses of the box centre to a ``.json`` file that `read_trajectory` gives back bit by bit."""
    document = {
        "reference": "box_center",
        "times": trajectory.times.tolist(),
        "world_from_vehicle": trajectory.world_from_vehicle.tolist(),
    }
    with new_file(path) as draft:
        draft.write_text(json.dumps(document))


def _read_json(text: str) -> tuple[NDArray, NDArray, str]:
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({error})") from None
    if not isinstance(document, dict) or "times" not in document:
        raise InputError('a trajectory is an object with "times" and poses')
    times = _numbers(document, "times", ())
    reference = str(document.get("reference", REFERENCES[0]))
    if "world_from_vehicle" in document:
        return times, _numbers(document, "world_from_vehicle", (4, 4)), reference
    if "positions" not in document or "quaternions" not in document:
        raise InputError('poses are given as "world_from_vehicle", or as "positions" and "quaternions"')
    positions = _numbers(document, "positions", (3,))
    quats = _numbers(document, "quaternions", (4,))
    if len(positions) != len(quats):
        raise InputError(f"there are {len(positions)} positions but {len(quats)} quaternions")
    if (abs(np.linalg.norm(quats, axis=1) - 1) > 1e-3).any():
        raise InputError("quaternions (w, x, y, z) have length 1; normalise them")
    return times, pose(rotation_from_quat(quats), positions), reference


def _numbers(document: dict, key: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    try:
        values = np.array(document[key], np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.full(1, np.nan)
    if values.ndim != 1 + len(shape) or values.shape[1:] != shape or not np.isfinite(values).all():
        form = " x ".join(["T", *map(str, shape)])
        raise InputError(f'"{key}" is a list of {form} finite numbers')
    return values


def _read_csv(text: str) -> tuple[NDArray, NDArray, str]:
    lines = text.splitlines()
    reference = REFERENCES[0]
    if lines and lines[0].startswith("#"):
        reference = lines[0].removeprefix("#").strip().removeprefix("reference:").strip()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    header = [name.strip() for name in rows.fieldnames or ()]
    rows.fieldnames = header
    lacking = [name for name in _COLUMNS if name not in header]
    if lacking:
        raise InputError(f"the header is t,x,y,z,heading[,pitch,roll], it lacks {', '.join(lacking)}")
    columns = [*_COLUMNS, *(name for name in _OPTIONAL_COLUMNS if name in header)]
    values = []
    for number, row in enumerate(rows, start=1):
        try:
            values.append([float(row[name]) for name in columns])
        except (TypeError, ValueError):
            raise InputError(f"row {number} after the header is not {len(columns)} numbers") from None
    table = np.array(values).reshape(-1, len(columns))
    if not np.isfinite(table).all():
        raise InputError("all numbers are finite, some are not")
    column = dict(zip(columns, table.T, strict=True))
    pitch = column.get("pitch", np.zeros(len(table)))
    roll = column.get("roll", np.zeros(len(table)))
    rotation = yaw_rotation(column["heading"]) @ _about_y(pitch) @ _about_x(roll)
    return column["t"], pose(rotation, np.stack([column[axis] for axis in "xyz"], 1)), reference


# The same rotation with the axes named in another order: x y z -> y z x, and x y z -> z x y.
def _about_x(angle: NDArray) -> NDArray[np.float64]:
    return np.roll(yaw_rotation(angle), (1, 1), (-2, -1))


def _about_y(angle: NDArray) -> NDArray[np.float64]:
    return np.roll(yaw_rotation(angle), (2, 2), (-2, -1))
