"""Our own Scene folder: what the stages write for each other, back bit by bit.

``scene.json`` holds every number (JSON keeps float64 exactly), ``<camera>.avi`` the pixels (MagicYUV),
``<camera>.reactive_mask.avi`` the masks of the frames that have one, ``sweeps.safetensors`` the LiDAR. Any of
them opens in everyday tools, and nothing in them can run.
"""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from dwgs.files import new_folder
from dwgs.scene.camera import Camera
from dwgs.scene.errors import InputError
from dwgs.scene.lidar import LidarSweep
from dwgs.scene.scene import Frame, Scene
from dwgs.scene.track import Track
from dwgs.scene.trajectory import Trajectory
from dwgs.video import LosslessVideo, write_lossless

SCENE_FILE = "scene.json"
FORMAT = "dwgs-scene"
VERSION = 1

_CAMERA_NAME = re.compile(r"\w[\w-]*")


def write(scene: Scene, path: Path, on_progress: Callable[[int, int], None] | None = None) -> None:
    """Write the scene to the folder ``path``, whole or not at all; ``on_progress`` hears (done, total)."""
    total = len(scene.all_frames())
    done = 0

    def pixels(frames: tuple[Frame, ...]) -> Iterator[NDArray[np.uint8]]:
        nonlocal done
        for frame in frames:
            yield frame.pixels
            done += 1
            if on_progress:
                on_progress(done, total)

    for name in scene.frames:
        if not _CAMERA_NAME.fullmatch(name):
            raise InputError(f"a camera name is letters, digits, _ and -, got '{name}'; rename the camera")
    with new_folder(path) as draft:
        for name, frames in scene.frames.items():
            write_lossless(draft / f"{name}.avi", pixels(frames), _fps(frames))
            masks = [frame for frame in frames if frame.load_reactive_mask]
            if masks:
                grey = (np.uint8(255) * np.asarray(frame.reactive_mask, bool) for frame in masks)
                write_lossless(draft / f"{name}.reactive_mask.avi", grey, _fps(frames))
        arrays = {}
        for i, sweep in enumerate(scene.sweeps):
            arrays |= {f"{i}.points": sweep.points, f"{i}.times": sweep.times}
            if sweep.labels is not None:
                arrays[f"{i}.labels"] = sweep.labels
        if arrays:
            contiguous = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
            (draft / "sweeps.safetensors").write_bytes(save(contiguous))
        (draft / SCENE_FILE).write_text(json.dumps(_document(scene)))


def read(path: Path) -> Scene:
    """The scene in the folder ``path``; pixels and masks are decoded when asked for.

    Raises `InputError` where anything is missing, damaged, of another version or at odds with the rest.
    """
    path = Path(path)
    file = path / SCENE_FILE
    try:
        document = json.loads(file.read_text())
    except FileNotFoundError:
        raise InputError(f"there is no '{file}'; give a folder that a stage wrote") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"'{file}' is not JSON ({error}); write the scene again") from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InputError(f'\'{file}\' is not a scene: it lacks "format": "{FORMAT}"')
    if document.get("version") != VERSION:
        raise InputError(
            f"'{file}' is a scene of version {document.get('version')}, "
            f"this program reads version {VERSION}; write it again"
        )
    try:
        return Scene(
            name=str(document["name"]),
            frames={name: _frames(path, name, entries) for name, entries in document["cameras"].items()},
            ego=_trajectory(document["ego"]),
            sweeps=_sweeps(path / "sweeps.safetensors", document["sweeps"]),
            tracks=tuple(_track(entry) for entry in document["tracks"]),
        )
    except InputError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"'{file}' is damaged ({error!r}); write the scene again") from None


def _document(scene: Scene) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": scene.name,
        "cameras": {
            name: [
                {
                    "index": frame.index,
                    "time": float(frame.camera.time),
                    "width": frame.camera.width,
                    "height": frame.camera.height,
                    "K": frame.camera.K.tolist(),
                    "world_from_camera": frame.camera.world_from_camera.tolist(),
                    "has_reactive_mask": frame.load_reactive_mask is not None,
                }
                for frame in frames
            ]
            for name, frames in scene.frames.items()
        },
        "ego": _trajectory_entry(scene.ego),
        "sweeps": [
            {
                "frame_index": sweep.frame_index,
                "time": float(sweep.time),
                "origin": sweep.origin.tolist(),
                "has_labels": sweep.labels is not None,
            }
            for sweep in scene.sweeps
        ],
        "tracks": [
            {
                "id": track.id,
                "category": track.category,
                "size": track.size.tolist(),
                "is_moving": track.is_moving,
                "is_vehicle": track.is_vehicle,
                "trajectory": _trajectory_entry(track.trajectory),
            }
            for track in scene.tracks
        ],
    }


def _trajectory_entry(trajectory: Trajectory) -> dict[str, Any]:
    return {"times": trajectory.times.tolist(), "world_from_vehicle": trajectory.world_from_vehicle.tolist()}


def _trajectory(entry: dict[str, Any]) -> Trajectory:
    return Trajectory(_floats(entry["times"]), _floats(entry["world_from_vehicle"]))


def _track(entry: dict[str, Any]) -> Track:
    return Track(
        id=str(entry["id"]),
        category=str(entry["category"]),
        size=_floats(entry["size"], (3,)),
        trajectory=_trajectory(entry["trajectory"]),
        is_moving=bool(entry["is_moving"]),
        is_vehicle=bool(entry["is_vehicle"]),
    )


def _frames(path: Path, name: str, entries: list[dict[str, Any]]) -> tuple[Frame, ...]:
    if not _CAMERA_NAME.fullmatch(name):
        raise InputError(f"a camera name is letters, digits, _ and -, '{path / 'scene.json'}' has '{name}'")
    cameras = [
        Camera(
            K=_floats(entry["K"], (3, 3)),
            width=int(entry["width"]),
            height=int(entry["height"]),
            world_from_camera=_floats(entry["world_from_camera"], (4, 4)),
            time=float(entry["time"]),
        )
        for entry in entries
    ]
    masked = [i for i, entry in enumerate(entries) if entry["has_reactive_mask"]]
    video = _video(path / f"{name}.avi", cameras)
    masks = _video(path / f"{name}.reactive_mask.avi", [cameras[i] for i in masked]) if masked else None
    return tuple(
        Frame(
            index=int(entry["index"]),
            camera_name=name,
            camera=cameras[i],
            load_pixels=_pixel_loader(video, i),
            load_reactive_mask=_mask_loader(masks, masked.index(i)) if masks and i in masked else None,
        )
        for i, entry in enumerate(entries)
    )


def _video(file: Path, cameras: list[Camera]) -> LosslessVideo:
    video = LosslessVideo(file)
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(video) != len(cameras) or sizes != {(video.width, video.height)}:
        raise InputError(
            f"'{file}' holds {len(video)} frames of {video.width}x{video.height}, "
            f"not the {len(cameras)} that scene.json describes; write the scene again"
        )
    return video


def _pixel_loader(video: LosslessVideo, i: int) -> Callable[[], NDArray[np.uint8]]:
    return lambda: video[i]


def _mask_loader(video: LosslessVideo, i: int) -> Callable[[], NDArray[np.bool_]]:
    return lambda: video[i] > 0


def _sweeps(file: Path, entries: list[dict[str, Any]]) -> tuple[LidarSweep, ...]:
    if not entries:
        return ()
    try:
        with safe_open(file, framework="numpy") as arrays:
            return tuple(
                LidarSweep(
                    points=_array(arrays.get_tensor(f"{i}.points"), np.float32, 2),
                    times=_array(arrays.get_tensor(f"{i}.times"), np.float64, 1),
                    origin=_floats(entry["origin"], (3,)),
                    time=float(entry["time"]),
                    frame_index=int(entry["frame_index"]),
                    labels=_array(arrays.get_tensor(f"{i}.labels"), np.uint8, 1) if entry["has_labels"] else None,
                )
                for i, entry in enumerate(entries)
            )
    except (OSError, SafetensorError) as error:
        raise InputError(f"'{file}' is missing or damaged ({error}); write the scene again") from None


def _array(array: NDArray, dtype: type, dimensions: int) -> NDArray:
    if array.dtype != dtype or array.ndim != dimensions:
        raise ValueError(f"a sweep has an array of {array.dtype} {array.shape}")
    return array


def _floats(values: Any, shape: tuple[int, ...] | None = None) -> NDArray[np.float64]:
    array = np.array(values, np.float64)
    if not np.isfinite(array).all():
        raise ValueError("a number is not finite")
    return array if shape is None else array.reshape(shape)


def _fps(frames: tuple[Frame, ...]) -> float:
    """For people who play the file; the times that count are in scene.json."""
    steps = np.diff([frame.camera.time for frame in frames])
    return float(np.clip(1 / np.median(steps), 1, 120)) if len(steps) and np.median(steps) > 0 else 10.0
