"""A vehicle asset as a folder: ``gaussians.ply`` (the body), ``shadow.ply``, ``asset.json``.

Where it is known, ``observations.npy`` says for each Gaussian of the body how many frames saw it. Where the sun was
found, ``asset.json`` says where it stands, ``shadow_heights.npy`` how high above the ground each Gaussian of the
shadow is cast from [m], and ``body_shading.npy`` how the body's colours follow the sun, between which ``slopes``. Where
wheels roll, ``asset.json`` says about which hub, with which radius, and how many of the body's last Gaussians.
"""

from operator import index
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_folder
from dwgs.formats import ply
from dwgs.formats.document import read_document, write_document
from dwgs.scene import Casting, InputError, Shading, VehicleAsset, Wheel

OBSERVATIONS = "observations.npy"
HEIGHTS, SHADING = "shadow_heights.npy", "body_shading.npy"
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
    if asset.casting is not None:
        content["sun"] = {"in_world": asset.casting.sun.tolist(), "in_vehicle": asset.casting.sun_at_rest.tolist()}
        if asset.shading is not None:
            content["sun"]["slopes"] = asset.shading.slopes.tolist()
    if asset.wheels:
        content["wheels"] = [
            {"hub": [float(x) for x in wheel.hub], "radius": float(wheel.radius), "gaussians": wheel.count}
            for wheel in asset.wheels
        ]
    with new_folder(path) as draft:
        ply.write(asset.body, draft / "gaussians.ply")
        ply.write(asset.shadow, draft / "shadow.ply")
        if asset.observations is not None:
            np.save(draft / OBSERVATIONS, np.asarray(asset.observations, np.uint32))
        if asset.casting is not None:
            np.save(draft / HEIGHTS, np.asarray(asset.casting.heights, np.float32))
            if asset.shading is not None:
                np.save(draft / SHADING, np.asarray(asset.shading.by_slope, np.float32))
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
    observations = _per_gaussian(path / OBSERVATIONS, (len(body),), np.uint32)
    casting = _casting(path, document.get("sun"), len(shadow))
    shading = _shading(path, document.get("sun"), len(body))
    wheels = _wheels(path / "asset.json", document.get("wheels", []), len(body))
    return VehicleAsset(body, shadow, size, category, provenance, quality, observations, casting, shading, wheels)


def _wheels(path: Path, entries: list, count: int) -> tuple[Wheel, ...]:
    """What the document at ``path`` says of a body of ``count`` Gaussians."""
    try:
        wheels = tuple(
            Wheel(np.array(entry["hub"], np.float64), float(entry["radius"]), index(entry["gaussians"]))
            for entry in entries
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"'{path}' has a wheel without hub, radius, or a number of Gaussians: {error}") from error
    for wheel in wheels:
        if wheel.hub.shape != (3,) or not np.isfinite(wheel.hub).all() or not 0 < wheel.radius < np.inf:
            raise InputError(
                f"'{path}' has a wheel of radius {wheel.radius} about {wheel.hub.tolist()}; "
                "a hub is x, y, z, a radius positive [m]"
            )
    counts = [wheel.count for wheel in wheels]
    if any(own < 1 for own in counts) or sum(counts) > count:
        raise InputError(f"'{path}' has wheels of {counts} Gaussians; each has some of the body's {count}, and its own")
    return wheels


def _casting(path: Path, sun: dict | None, count: int) -> Casting | None:
    """How the shadow was cast, where the document says so."""
    if sun is None:
        return None
    heights = _per_gaussian(path / HEIGHTS, (count,), np.float32)
    try:
        in_world, in_vehicle = (np.array(sun[name], np.float64) for name in ("in_world", "in_vehicle"))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"'{path / 'asset.json'}' has a sun without two directions: {error}") from error
    if any(d.shape != (3,) or not np.isfinite(d).all() or not d[2] > 0 for d in (in_world, in_vehicle)):
        raise InputError(f"'{path / 'asset.json'}' has the sun at {sun}; each direction is x, y, z with z above 0")
    if heights is None or not np.isfinite(heights).all():
        raise InputError(f"'{path / HEIGHTS}' is missing or not finite, though asset.json has a sun; write it anew")
    return Casting(in_world, in_vehicle, heights)


def _shading(path: Path, sun: dict | None, count: int) -> Shading | None:
    """How the body's colours follow the sun, where the document says so."""
    if sun is None or "slopes" not in sun:
        return None
    by_slope = _per_gaussian(path / SHADING, (count, 2, 3), np.float32)
    try:
        slopes = np.array(sun["slopes"], np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"'{path / 'asset.json'}' has slopes of the sun that are no numbers: {error}") from error
    if slopes.shape != (2, 2) or not np.isfinite(slopes).all() or (slopes[0] > slopes[1]).any():
        raise InputError(
            f"'{path / 'asset.json'}' has slopes {sun['slopes']}; they are two lowest, two highest numbers"
        )
    if by_slope is None or not np.isfinite(by_slope).all():
        raise InputError(f"'{path / SHADING}' is missing or not finite, though asset.json has slopes; write it anew")
    return Shading(by_slope, slopes)


def _per_gaussian(path: Path, shape: tuple[int, ...], dtype: type) -> NDArray | None:
    """Of this shape what the file holds, where there is one."""
    if not path.exists():
        return None
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)  # whatever its header says, nothing is allocated
    except (ValueError, EOFError, OSError) as error:
        raise InputError(f"'{path}' is not an array of numbers: {error}; write the asset anew") from error
    if values.shape != shape or values.dtype != dtype:
        raise InputError(
            f"'{path}' is {values.dtype} {values.shape}, for so many Gaussians it is {np.dtype(dtype)} {shape}; "
            "write the asset anew"
        )
    return np.array(values)
