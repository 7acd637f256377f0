"""A background as a folder: ``gaussians.ply``, ``sky.npy``, ``background.json``; exact, provably frozen."""

import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_folder
from dwgs.formats import ply
from dwgs.formats.document import read_document, write_document
from dwgs.scene import Background, InputError
from dwgs.scene.pose import is_rigid

FILES = ("gaussians.ply", "sky.npy", "background.json")
STAMP = {
    "format": "dwgs background",
    "format_version": 1,
    "frame": {
        "axes": "the recording's world, z up",
        "cameras": "x right, y down, z forward",
        "length_unit": "metre",
        "quaternion": "wxyz",
        "spherical_harmonics": "real, DC first, in the world's axes",
        "sky": "equirectangular, row 0 up, column 0 along -x, u grows with atan2(y, x)",
        "colour": "sRGB",
    },
}
"""What every background of this version says, checked on reading."""


def write(background: Background, path: Path) -> None:
    """Write the folder ``path``, whole or not at all, in place of what was there."""
    poses: dict[str, dict[str, list]] = {}
    for (camera, frame), world_from_camera in background.poses.items():
        poses.setdefault(camera, {})[str(frame)] = world_from_camera.tolist()
    exposure = {camera: [float(gain) for gain in gains] for camera, gains in background.exposure.items()}
    content = {"gaussians": len(background.gaussians), "exposure": exposure, "poses": poses}
    with new_folder(path) as draft:
        ply.write(background.gaussians, draft / "gaussians.ply")
        np.save(draft / "sky.npy", background.sky, allow_pickle=False)
        write_document(content, STAMP, draft / "background.json")


def read(path: Path) -> Background:
    """The background in the folder ``path``; `InputError` where a file is missing or corrupt."""
    path = Path(path)
    document = read_document(STAMP, path / "background.json")
    gaussians = ply.read(path / "gaussians.ply")
    try:
        count = document["gaussians"]
        exposure = {camera: np.array(gains, np.float32) for camera, gains in document["exposure"].items()}
        poses = {
            (camera, int(frame)): np.array(pose, np.float64)
            for camera, frames in document["poses"].items()
            for frame, pose in frames.items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"'{path / 'background.json'}' lacks an entry or has it in another form: {error}") from error
    if any(gains.shape != (3,) or not np.isfinite(gains).all() for gains in exposure.values()):
        raise InputError(f"'{path / 'background.json'}' has an exposure that is not three finite gains")
    if not all(is_rigid(pose) for pose in poses.values()):
        raise InputError(f"'{path / 'background.json'}' has a pose that is not a rotation and a translation")
    if len(gaussians) != count:
        raise InputError(f"'{path / 'background.json'}' counts {count} Gaussians, gaussians.ply holds {len(gaussians)}")
    return Background(gaussians, _read_sky(path / "sky.npy"), exposure, poses)


def fingerprint(path: Path) -> str:
    """SHA-256 over the bytes of the folder's files in fixed order: equal before and after, or not frozen."""
    digest = hashlib.sha256()
    for name in FILES:
        with (Path(path) / name).open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def _read_sky(path: Path) -> NDArray[np.float32]:
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)  # compares header and size, allocates nothing
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"'{path}' holds no sky: it is missing, cut short or corrupt") from error
    if not isinstance(mapped, np.ndarray) or mapped.dtype != np.float32 or not np.isfinite(mapped).all():
        raise InputError(f"'{path}' holds no sky: one is an array of finite float32")
    return np.array(mapped)
