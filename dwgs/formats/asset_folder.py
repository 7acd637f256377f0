"""A vehicle asset as a folder: ``gaussians.ply`` (the body), ``shadow.ply``, ``asset.json``.

Where it is known, ``observations.npy`` says for each Gaussian of the body how many frames saw it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_folder
from dwgs.formats import ply
from dwgs.formats.document import read_document, write_document
from dwgs.scene import InputError, VehicleAsset

OBSERVATIONS = "observations.npy"
STAMP = {
    "format": "dwgs vehicle asset",
    "format_version": 1,
    "frame": {
        "axes": "x forward, y left, z up",
        "origin": "box centre",
        "length_unit": "metre",
        "quaternion": "wxyz",
        "spherical_harmonics": "real, DC first, in the axes above",
        "colour": "sRGB",
        "motion": "rigid",
    },
}
"""What every asset of this version says, checked on reading: a wrong frame must not pass as a strange car."""


def write(asset: VehicleAsset, path: Path) -> None:
    """Write the folder ``path``, whole or not at all, in place of what was there."""
    content = {
        "category": asset.category,
        "size": [float(side) for side in asset.size],
        "gaussians": {"body": len(asset.body), "shadow": len(asset.shadow)},
        "quality": asset.quality,
        "provenance": asset.provenance,
    }
    with new_folder(path) as draft:
        ply.write(asset.body, draft / "gaussians.ply")
        ply.write(asset.shadow, draft / "shadow.ply")
        if asset.observations is not None:
            np.save(draft / OBSERVATIONS, np.asarray(asset.observations, np.uint32))
        write_document(content, STAMP, draft / "asset.json")


def read(path: Path) -> VehicleAsset:
    """The asset in the folder ``path``; `InputError` where a file is missing or contradicts another."""
    path = Path(path)
    document = read_document(STAMP, path / "asset.json")
    try:
        size = np.array(document["size"], np.float64)
        counts = document["gaussians"]["body"], document["gaussians"]["shadow"]
        category, provenance = str(document["category"]), dict(document["provenance"])
        quality = dict(document["quality"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"'{path / 'asset.json'}' lacks an entry or has it in another form: {error}") from error
    if size.shape != (3,) or not np.isfinite(size).all() or (size <= 0).any():
        raise InputError(f"'{path / 'asset.json'}' has size {document['size']}; it is three positive lengths [m]")
    body, shadow = ply.read(path / "gaussians.ply"), ply.read(path / "shadow.ply")
    if (len(body), len(shadow)) != counts:
        raise InputError(
            f"'{path / 'asset.json'}' counts {counts[0]} + {counts[1]} Gaussians, the PLY files hold "
            f"{len(body)} + {len(shadow)}; the folder is a mixture of two"
        )
    observations = _observations(path / OBSERVATIONS, len(body))
    return VehicleAsset(body, shadow, size, category, provenance, quality, observations)


def _observations(path: Path, count: int) -> NDArray[np.uint32] | None:
    """[count] of the file, where there is one."""
    if not path.exists():
        return None
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)  # whatever its header says, nothing is allocated
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"'{path}' is not an array of numbers: {error}; write the asset anew") from error
    if values.shape != (count,) or values.dtype != np.uint32:
        raise InputError(f"'{path}' is {values.dtype} {values.shape}, the asset has {count} Gaussians; write it anew")
    return np.array(values)
