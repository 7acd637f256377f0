"""Conditions and insertions as folders."""

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_folder
from dwgs.formats.document import read_document, write_document
from dwgs.scene import Frame, InputError, Insertion, Scene, Trajectory, VehiclePoints
from dwgs.video import LosslessVideo, write_lossless
from generator.conditions.cloud import read_cloud, write_cloud
from generator.conditions.conditions import ConditionFrame, Conditions

CONDITIONS_STAMP = {"format": "dwgs conditions", "format_version": 1}
INSERTION_STAMP = {
    "format": "dwgs insertion",
    "format_version": 1,
    "frame": {"axes": "x forward, y left, z up", "origin": "box centre", "length_unit": "metre"},
}


def write(conditions: Conditions, path: Path) -> None:
    """Write a folder that people can watch and `read` reads: whole or not at all.

    ``conditions.json``, ``insertion/`` (`write_insertion`), and for each camera the lossless videos
    ``points.avi``, ``point_mask.avi``, ``reactive_mask.avi`` and ``inactive.avi`` (the recording with a grey
    hole).
    """
    cameras = {name: [_identity(f.frame) for f in frames] for name, frames in conditions.frames.items()}
    with new_folder(path) as draft:
        write_insertion(conditions.insertion, draft / "insertion")
        for name, frames in conditions.frames.items():
            folder = _camera_folder(draft, name)
            folder.mkdir()
            fps = _rate([f.frame.camera.time for f in frames])
            videos: dict[str, Iterable[NDArray[np.uint8]]] = {
                "points": (f.load_point_image() for f in frames),
                "point_mask": (np.uint8(255) * f.load_point_mask() for f in frames),
                "reactive_mask": (np.uint8(255) * f.load_reactive_mask() for f in frames),
                "inactive": (f.load_inactive_image() for f in frames),
            }
            for kind, images in videos.items():
                write_lossless(folder / f"{kind}.avi", images, fps)
        write_document(
            {"scene": conditions.scene.name, "cameras": cameras}, CONDITIONS_STAMP, draft / "conditions.json"
        )


def read(path: Path, scene: Scene) -> Conditions:
    """Conditions that `write` wrote for the frames of ``scene``.

    Raises:
        InputError: The folder is incomplete, damaged, or was made for other frames.
    """
    path = Path(path)
    document = read_document(CONDITIONS_STAMP, path / "conditions.json")
    cameras = document.get("cameras")
    expected = {name: [_identity(f) for f in frames] for name, frames in scene.frames.items()}
    if cameras != expected:
        raise InputError(
            f"'{path}' holds conditions for {_summary(cameras)}, but '{scene.name}' has {_summary(expected)}"
            "; choose the same frames, cameras and size, or make the conditions again"
        )
    frames = {}
    for name, recorded in scene.frames.items():
        folder = _camera_folder(path, name)
        videos = [LosslessVideo(folder / f"{kind}.avi") for kind in ("points", "point_mask", "reactive_mask")]
        for video in videos:
            size = (recorded[0].camera.width, recorded[0].camera.height)
            if len(video) != len(recorded) or (video.width, video.height) != size:
                raise InputError(
                    f"'{video.path}' has {len(video)} frames of {video.width}x{video.height}, not "
                    f"{len(recorded)} of {size[0]}x{size[1]}; make the conditions again"
                )
        points, point_mask, reactive_mask = videos
        frames[name] = tuple(
            ConditionFrame(
                frame,
                partial(points.__getitem__, i),
                partial(_mask, point_mask, i),
                partial(_mask, reactive_mask, i),
            )
            for i, frame in enumerate(recorded)
        )
    return Conditions(scene, read_insertion(path / "insertion"), frames)


def write_insertion(insertion: Insertion, path: Path) -> None:
    """Write a folder with ``points.ply`` (coloured points in the vehicle frame) and ``insertion.json``."""
    content = {
        "category": insertion.category,
        "size": [float(side) for side in insertion.size],
        "is_complete": insertion.vehicle.is_complete,
        "trajectory": {
            "times": insertion.trajectory.times.tolist(),
            "world_from_vehicle": insertion.trajectory.world_from_vehicle.tolist(),
        },
    }
    with new_folder(path) as draft:
        write_cloud(insertion.vehicle, draft / "points.ply")
        write_document(content, INSERTION_STAMP, draft / "insertion.json")


def read_insertion(path: Path) -> Insertion:
    """The insertion that `write_insertion` wrote.

    Raises:
        InputError: The folder is incomplete or says something that cannot be.
    """
    path = Path(path)
    document = read_document(INSERTION_STAMP, path / "insertion.json")
    try:
        size = np.array(document["size"], np.float64)
        times = np.array(document["trajectory"]["times"], np.float64)
        poses = np.array(document["trajectory"]["world_from_vehicle"], np.float64)
        category, is_complete = str(document["category"]), bool(document["is_complete"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"'{path / 'insertion.json'}' lacks or garbles {error}; write it again") from None
    if size.shape != (3,) or not (np.isfinite(size) & (size > 0)).all():
        raise InputError(f"a size is three positive lengths [m], '{path / 'insertion.json'}' says {document['size']}")
    if not (path / "points.ply").is_file():
        raise InputError(f"'{path}' has no points.ply; the insertion is incomplete, write it again")
    points, colors, normals = read_cloud(path / "points.ply")
    if colors is None:
        raise InputError(f"'{path / 'points.ply'}' has no colours; write it again")
    normals = None if normals is None else normals.astype(np.float32)
    vehicle = VehiclePoints(points.astype(np.float32), colors, normals, is_complete)
    return Insertion(vehicle, size, Trajectory(times, poses), category)


def _identity(frame: Frame) -> dict[str, Any]:
    """What must agree for a drawing to belong to a frame."""
    return {
        "index": frame.index,
        "time": frame.camera.time,
        "size": [frame.camera.width, frame.camera.height],
    }


def _summary(cameras: Any) -> str:
    try:
        parts = []
        for name, frames in cameras.items():
            first, last = frames[0], frames[-1]
            width, height = first["size"]
            parts.append(f"{name} {first['index']}-{last['index']} ({len(frames)} frames of {width}x{height})")
        return ", ".join(parts)
    except (AttributeError, KeyError, IndexError, TypeError, ValueError):
        return "nothing that can be understood"


def _camera_folder(path: Path, name: str) -> Path:
    if name in ("", ".", "..", "insertion") or "/" in name or "\\" in name:
        raise InputError(f"a camera's name is a folder's name other than 'insertion', not '{name}'; rename it")
    return path / name


def _rate(times: list[float]) -> float:
    """Frames per second, for players."""
    return 1 / float(np.median(np.diff(times))) if len(times) > 1 else 10.0


def _mask(video: LosslessVideo, index: int) -> NDArray[np.bool_]:
    return video[index] > 127
