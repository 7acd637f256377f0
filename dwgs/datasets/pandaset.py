"""PandaSet in its native layout.

A sequence (Xiao et al., "PandaSet: Advanced Sensor Suite Dataset for Autonomous Driving", 2021) is a folder
with ``camera/<name>/NN.jpg``, ``lidar/NN.pkl.gz`` and ``annotations/{cuboids,semseg}/NN.pkl.gz``, poses and
stamps in JSON beside them. Poses and stamps are lists over *all* frames of the recording, so they are indexed
by frame number: a folder may hold any part of the frames, and a frame may lack its sweep.

Of the two LiDARs only the spinning one is read (``d == 0``); points are in the world already. What the format
calls the LiDAR pose is the recording car's: x right, y forward, z up, near the ground.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dwgs.datasets.pandaset_tracks import Cuboids, read_tracks
from dwgs.datasets.tables import read_table
from dwgs.scene.camera import Camera
from dwgs.scene.errors import InputError
from dwgs.scene.lidar import SURFACES, LidarSweep
from dwgs.scene.pose import pose, rotation_from_quat, transform_points
from dwgs.scene.scene import Frame, Scene
from dwgs.scene.trajectory import Trajectory

CAMERAS = (
    "front_camera",
    "front_left_camera",
    "front_right_camera",
    "left_camera",
    "right_camera",
    "back_camera",
)
"""In order of interest: the first one present is the scene's main camera."""

_LOCAL_FROM_EGO = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
_LIDAR_IN_LOCAL = np.array([0.0, 0.72, 1.86])
"""Not in the recording: the point that the returns of each millisecond fan out from, at the height that the
rings on flat road say; good to 0.1 m."""

_SURFACE_OF_CLASS = {
    "ground": "Ground, Road, Lane Line Marking, Stop Line Marking, Other Road Marking, Sidewalk, Driveway",
    "vehicle": "Car, Pickup Truck, Medium-sized Truck, Semi-truck, Towed Object, Motorcycle, "
    "Other Vehicle - Construction Vehicle, Other Vehicle - Uncommon, Other Vehicle - Pedicab, "
    "Emergency Vehicle, Bus, Personal Mobility Device, Motorized Scooter, Bicycle, Train, Trolley, "
    "Tram / Subway",
    "person": "Pedestrian, Pedestrian with Object, Animals - Bird, Animals - Other",
    "noise": "Smoke, Exhaust, Spray or rain, Reflection",
}
"""Surfaces by class name; every other class is static."""


def read(path: Path) -> Scene:
    """The PandaSet sequence in the folder ``path``; images are decoded when asked for.

    Times are seconds since the recording's first sweep. Raises `InputError` where a file is missing or
    broken.
    """
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"there is no folder '{path}'; give the folder of one PandaSet sequence")
    stamps = _stamps(path / "lidar")
    start = stamps[0]
    world_from_local = _poses(path / "lidar", len(stamps))
    ego = Trajectory(stamps - start, world_from_local @ _LOCAL_FROM_EGO)
    frames = {
        name: _read_camera(path / "camera" / name, start) for name in sorted(_folders(path / "camera"), key=_interest)
    }
    if not frames:
        raise InputError(f"'{path / 'camera'}' holds no camera; a PandaSet sequence has front_camera and others")
    sweeps = tuple(
        _read_sweep(path, number, world_from_local[number], stamps[number], start)
        for number in _numbers(path / "lidar", ".pkl.gz", len(stamps))
    )
    cuboids = path / "annotations" / "cuboids"
    boxes = {
        number: Cuboids.from_table(read_table(cuboids / f"{number:02}.pkl.gz"), cuboids)
        for number in _numbers(cuboids, ".pkl.gz", len(stamps))
    }
    return Scene(
        name=path.resolve().name,
        frames=frames,
        ego=ego,
        sweeps=sweeps,
        tracks=read_tracks(boxes, sweeps, stamps - start),
    )


def _interest(camera: str) -> tuple[int, str]:
    return (CAMERAS.index(camera) if camera in CAMERAS else len(CAMERAS), camera)


def _read_camera(folder: Path, start: float) -> tuple[Frame, ...]:
    stamps = _stamps(folder)
    world_from_camera = _poses(folder, len(stamps))
    intrinsics = _json(folder / "intrinsics.json")
    try:
        fx, fy, cx, cy = (float(intrinsics[key]) for key in ("fx", "fy", "cx", "cy"))
    except (KeyError, TypeError, ValueError):
        raise InputError(f"'{folder / 'intrinsics.json'}' has fx, fy, cx and cy as numbers") from None
    # The format counts pixel centres from 0, this project from 0.5.
    K = np.array([[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]])
    numbers = _numbers(folder, ".jpg", len(stamps))
    if not numbers:
        raise InputError(f"'{folder}' holds no image NN.jpg; remove the folder or fetch its images")
    width, height = _image_size(folder / f"{numbers[0]:02}.jpg")
    return tuple(
        Frame(
            index=number,
            camera_name=folder.name,
            camera=Camera(K, width, height, world_from_camera[number], float(stamps[number] - start)),
            load_pixels=_image_loader(folder / f"{number:02}.jpg"),
        )
        for number in numbers
    )


def _read_sweep(path: Path, number: int, world_from_local: NDArray, stamp: float, start: float) -> LidarSweep:
    file = path / "lidar" / f"{number:02}.pkl.gz"
    table = read_table(file)
    try:
        points = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float32)
        times = table["t"].astype(np.float64) - start
        spinning = table["d"] == 0 if "d" in table else np.ones(len(points), bool)
    except (KeyError, ValueError, TypeError):
        raise InputError(f"'{file}' is a table with the columns x, y, z, t and d, it has {', '.join(table)}") from None
    keep = spinning & np.isfinite(points).all(1) & np.isfinite(times)
    labels = _read_labels(path / "annotations" / "semseg", number, len(points))
    return LidarSweep(
        points=points[keep],
        times=times[keep],
        origin=transform_points(world_from_local, _LIDAR_IN_LOCAL[None])[0],
        time=float(stamp - start),
        frame_index=number,
        labels=None if labels is None else labels[keep],
    )


def _read_labels(folder: Path, number: int, count: int) -> NDArray[np.uint8] | None:
    file = folder / f"{number:02}.pkl.gz"
    if not file.exists():
        return None
    classes = read_table(file).get("class")
    if classes is None or len(classes) != count or classes.dtype.kind not in "iu":
        raise InputError(f"'{file}' has one integer class for each of the sweep's {count} points; fetch both again")
    names = _json(folder / "classes.json")
    surface_of = {name: surface for surface, many in _SURFACE_OF_CLASS.items() for name in many.split(", ")}
    table = np.zeros(256, np.uint8)
    for key, name in names.items():
        table[int(key) % 256] = SURFACES.index(surface_of.get(name, "static"))
    return table[np.clip(classes, 0, 255)]


def _stamps(folder: Path) -> NDArray[np.float64]:
    stamps = _json(folder / "timestamps.json")
    try:
        stamps = np.array(stamps, np.float64)
    except (TypeError, ValueError):
        stamps = np.empty(0)
    if stamps.ndim != 1 or len(stamps) == 0 or not np.isfinite(stamps).all():
        raise InputError(f"'{folder / 'timestamps.json'}' is a list of times, one per frame of the recording")
    return stamps


def _poses(folder: Path, count: int) -> NDArray[np.float64]:
    """``world_from_local`` [count, 4, 4]."""
    poses = _json(folder / "poses.json")
    try:
        positions = np.array([[p["position"][k] for k in "xyz"] for p in poses], np.float64).reshape(-1, 3)
        quats = np.array([[p["heading"][k] for k in "wxyz"] for p in poses], np.float64).reshape(-1, 4)
    except (KeyError, TypeError, ValueError):
        positions, quats = np.empty((0, 3)), np.empty((0, 4))
    lengths = np.linalg.norm(quats, axis=1)
    if len(positions) != count or not np.isfinite(positions).all() or not (abs(lengths - 1) < 0.01).all():
        raise InputError(f"'{folder / 'poses.json'}' has a position and a unit heading for each of {count} stamps")
    return pose(rotation_from_quat(quats), positions)


def _json(file: Path) -> Any:
    try:
        return json.loads(file.read_text())
    except FileNotFoundError:
        raise InputError(f"there is no '{file}'; the recording is incomplete") from None
    except (OSError, ValueError) as error:
        raise InputError(f"'{file}' is not JSON ({error}); fetch it again") from None


def _folders(folder: Path) -> list[str]:
    return [child.name for child in folder.iterdir() if child.is_dir()] if folder.is_dir() else []


def _numbers(folder: Path, suffix: str, count: int) -> list[int]:
    """Numbers of the frames that have a file NN<suffix> in the folder."""
    names = [file.name.removesuffix(suffix) for file in folder.glob(f"*{suffix}")]
    numbers = sorted(int(name) for name in names if name.isdecimal())
    if numbers and numbers[-1] >= count:
        raise InputError(f"'{folder}' has frame {numbers[-1]} but stamps for frames 0-{count - 1} only")
    return numbers


def _image_size(file: Path) -> tuple[int, int]:
    try:
        with Image.open(file) as image:
            return image.size
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"'{file}' is not a whole JPEG ({error}); fetch it again") from None


def _image_loader(file: Path) -> Callable[[], NDArray[np.uint8]]:
    def load() -> NDArray[np.uint8]:
        try:
            with Image.open(file) as image:
                return np.array(image.convert("RGB"))
        except FileNotFoundError:
            raise InputError(f"there is no image '{file}'; fetch it again") from None
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            raise InputError(f"'{file}' is not a whole JPEG ({error}); fetch it again") from None

    return load
