"""Meshes to coloured points: what their textures and materials look like, sampled evenly over the surface."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.stats import qmc

from dwgs.scene import InputError
from generator.conditions.cloud import MAX_BYTES
from generator.conditions.surface import Convention, Surface

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".off")
"""Formats that are read."""

SAMPLES = 1 << 19
"""Points drawn on a mesh; a power of two, as the Sobol sequence likes it."""

GLASS = np.array([20, 22, 24])
"""sRGB of what is seen through a window: a dark cabin. Glass is drawn as if painted with it."""

_MAX_FACES = 20_000_000
_MAX_TEXTURE = 64 << 20  # pixels
_GREY = (127, 127, 127, 255)


def sample_mesh(path: Path, seed: int = 0) -> Surface:
    """`SAMPLES` points spread evenly over a mesh file's faces, in the file's own frame.

    Scene graphs are flattened, animations ignored. Files it refers to must lie in its own folder or below.

    Raises:
        InputError: The file is broken, too large, empty, or refers to something that is missing.
    """
    path = Path(path)
    remarks = _distrust(path)
    try:
        scene = trimesh.load_scene(path, process=False)
        parts = [
            (scene.geometry[geometry], np.asarray(transform, np.float64))
            for transform, geometry in (scene.graph[node] for node in scene.graph.nodes_geometry)
            if isinstance(scene.geometry[geometry], trimesh.Trimesh)
        ]
    except Exception as error:  # a parser given a stranger's file may raise anything
        raise InputError(f"{path.name} cannot be read as a {path.suffix[1:]} mesh: {error}") from None
    faces = sum(len(mesh.faces) for mesh, _ in parts)
    if not 0 < faces <= _MAX_FACES:
        raise InputError(f"a vehicle's mesh has 1 to {_MAX_FACES} faces, {path.name} has {faces}")

    corners = [_corners(mesh, transform) for mesh, transform in parts]
    triangles = np.concatenate(corners)
    if not np.isfinite(triangles).all():
        raise InputError(f"vertices are finite, some of {path.name} are not; repair the mesh")
    edges = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    if not areas.sum() > 0:
        raise InputError(f"a vehicle's mesh has faces with an area, those of {path.name} have none")

    u = qmc.Sobol(3, rng=np.random.default_rng(seed)).random(SAMPLES)
    u = u[np.argsort(u[:, 0], kind="stable")]
    chosen = np.searchsorted(np.cumsum(areas) / areas.sum(), u[:, 0]).clip(max=len(areas) - 1)
    root = np.sqrt(u[:, 1])  # uniform in a triangle
    weights = np.stack([1 - root, root * (1 - u[:, 2]), root * u[:, 2]], 1)
    points = np.einsum("pc,pcd->pd", weights, triangles[chosen])

    colors, opaque, normals = (
        np.empty((SAMPLES, 3), np.uint8),
        np.empty(SAMPLES, bool),
        np.empty((SAMPLES, 3)),
    )
    first = 0
    for (mesh, transform), own in zip(parts, corners, strict=True):
        here = (chosen >= first) & (chosen < first + len(own))
        face = chosen[here] - first
        colors[here], opaque[here] = _paint(mesh, face, weights[here], path.name)
        normals[here] = _normals(mesh, transform, own, face, weights[here])
        first += len(own)
    stated = Convention("m", "y", "z") if path.suffix.lower() in (".glb", ".gltf") else None
    return Surface(
        points[opaque], colors[opaque], normals[opaque], triangles, chosen[opaque], stated, tuple(remarks)
    )


def _distrust(path: Path) -> list[str]:
    """Check what can be checked before a parser sees the file; returns remarks."""
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"a vehicle's file is at most {MAX_BYTES >> 20} MiB, {path.name} has {size >> 20}")
    suffix = path.suffix.lower()
    if suffix in (".glb", ".gltf"):
        _distrust_gltf(path, size)
    if suffix != ".obj":
        return []
    with path.open(errors="replace") as file:
        libraries = [line.split(maxsplit=1)[1].strip() for line in file if line.startswith("mtllib ")]
    missing = [name for name in libraries if not _beside(path, name)]
    for name in set(libraries) - set(missing):
        text = (path.parent / name).read_text(errors="replace")
        missing += [
            t.strip() for t in re.findall(r"(?mi)^\s*map_Kd\s+(.+)$", text) if not _beside(path, t.strip())
        ]
    return [f"not found beside it, left out: {', '.join(sorted(set(missing)))}"] if missing else []


def _distrust_gltf(path: Path, size: int) -> None:
    with path.open("rb") as file:
        if path.suffix.lower() == ".glb":
            head = file.read(20)
            magic, _, _, length, kind = (
                struct.unpack("<4sIIII", head) if len(head) == 20 else (b"", 0, 0, 0, 0)
            )
            if magic != b"glTF" or kind != 0x4E4F534A or length > size - 20:
                raise InputError(
                    f"a .glb file begins with 'glTF' and a JSON chunk that fits, {path.name} does not"
                )
            text = file.read(length)
        else:
            text = file.read()
    try:
        tree = json.loads(text)
        items = sum(int(accessor["count"]) for accessor in tree.get("accessors", []))
        links = [
            item["uri"] for kind in ("buffers", "images") for item in tree.get(kind, []) if "uri" in item
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path.name} is not a valid glTF file: {error!r}") from None
    if items > 3 * _MAX_FACES:
        raise InputError(f"{path.name} declares {items} items of data, at most {3 * _MAX_FACES} are read")
    for link in links:
        if not link.startswith("data:") and not _beside(path, link):
            raise InputError(f"{path.name} refers to '{link[:80]}', which is not in its folder; put it there")


def _beside(path: Path, name: str) -> bool:
    """Whether a file refers to one that exists in its own folder or below."""
    target = (path.parent / name).resolve()
    return target.is_relative_to(path.parent.resolve()) and target.is_file()


def _corners(mesh: trimesh.Trimesh, transform: NDArray) -> NDArray[np.float64]:
    vertices = mesh.vertices @ transform[:3, :3].T + transform[:3, 3]
    return vertices[mesh.faces]


def _normals(
    mesh: trimesh.Trimesh, transform: NDArray, corners: NDArray, face: NDArray, weights: NDArray
) -> NDArray[np.float64]:
    """Unit normals [P, 3]: the mesh's smooth ones, where they agree with the face they belong to."""
    edges = corners[:, 1:] - corners[:, :1]
    flat = _unit(np.cross(edges[:, 0], edges[:, 1]))[face]
    smooth = np.einsum("pc,pcd->pd", weights, mesh.vertex_normals[mesh.faces[face]])
    smooth = _unit(smooth @ np.linalg.pinv(transform[:3, :3]))
    smooth *= np.where((smooth * flat).sum(1, keepdims=True) < 0, -1, 1)
    return np.where((smooth * flat).sum(1, keepdims=True) > 0.5, smooth, flat)


def _paint(
    mesh: trimesh.Trimesh, face: NDArray, weights: NDArray, name: str
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """sRGB [P, 3], and whether there is any surface [P], at barycentric ``weights`` of the given faces."""
    visual, count = mesh.visual, len(face)
    corners = mesh.faces[face]
    opaque = np.ones(count, bool)
    if isinstance(visual, trimesh.visual.ColorVisuals):
        if visual.kind == "face":
            rgba = visual.face_colors[face].astype(np.float64)
        elif visual.kind == "vertex":
            rgba = np.einsum("pc,pcd->pd", weights, visual.vertex_colors[corners].astype(np.float64))
        else:
            rgba = np.tile(np.array(_GREY, np.float64), (count, 1))
        return np.rint(rgba[:, :3]).astype(np.uint8), opaque

    material = visual.material
    is_gltf = isinstance(material, trimesh.visual.material.PBRMaterial)
    image = material.baseColorTexture if is_gltf else material.image
    factor = material.baseColorFactor if is_gltf else material.diffuse
    factor = np.full(4, 1.0) if factor is None else np.asarray(factor, np.float64) / 255
    alpha = np.full(count, factor[3])
    if image is not None and visual.uv is not None:
        uv = np.einsum("pc,pcd->pd", weights, visual.uv[corners])
        texels = _texture(image, uv, name)
        # glTF multiplies linear light; in an MTL file the map takes the place of Kd, as most exporters mean it
        rgb = _srgb(_linear(texels[:, :3]) * factor[:3]) if is_gltf else texels[:, :3]
        if is_gltf:
            alpha = alpha * texels[:, 3]
    else:
        rgb = np.tile(_srgb(factor[:3]) if is_gltf else factor[:3], (count, 1))
    if is_gltf:
        if material.alphaMode == "MASK":
            opaque = alpha >= (0.5 if material.alphaCutoff is None else material.alphaCutoff)
        if material.alphaMode != "BLEND":
            alpha = np.ones(count)
    else:
        dissolve = material.kwargs.get("d") or [1.0]
        alpha = np.full(count, float(dissolve[0]))
    rgb = alpha[:, None] * rgb + (1 - alpha[:, None]) * GLASS / 255
    return np.rint(rgb.clip(0, 1) * 255).astype(np.uint8), opaque


def _texture(image: Image.Image, uv: NDArray, name: str) -> NDArray[np.float64]:
    """Texels [P, 4] in [0, 1] at ``uv`` [P, 2] (v up, repeating), bilinear."""
    if image.width * image.height > _MAX_TEXTURE:
        raise InputError(
            f"a texture has at most {_MAX_TEXTURE >> 20} Mpx, one of {name} has {image.size}; shrink it"
        )
    try:
        image = image.convert("RGBA")
    except Exception as error:  # a decoder given a stranger's file may raise anything
        raise InputError(f"a texture of {name} cannot be decoded: {error}") from None
    return trimesh.visual.color.uv_to_interpolated_color(uv, image).astype(np.float64) / 255


def _linear(srgb: NDArray) -> NDArray[np.float64]:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _srgb(linear: NDArray) -> NDArray[np.float64]:
    return np.where(
        linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )


def _unit(vectors: NDArray) -> NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
