"""Meshes to coloured points: what their textures and materials look like, sampled evenly over the surface."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.stats import qmc

from dwgs.scene import InputError
from generator.conditions.cloud import MAX_BYTES
from generator.conditions.paint import CABIN, Spots, paint
from generator.conditions.surface import Convention, Surface

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".off")
"""Formats that are read."""

SAMPLES = 1 << 19
"""Points drawn on a mesh; a power of two, as the Sobol sequence likes it."""

_GLASS = re.compile(r"(?i)glass|window|windshield|windscreen")  # parts of that name are seen through
_CREASE = 0.75  # cosine between face and vertex normal: a sharper edge is an edge
_MAX_FACES = 20_000_000


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
            (geometry, scene.geometry[geometry], np.asarray(transform, np.float64))
            for transform, geometry in (scene.graph[node] for node in scene.graph.nodes_geometry)
            if isinstance(scene.geometry[geometry], trimesh.Trimesh)
        ]
    except Exception as error:  # a parser given a stranger's file may raise anything
        raise InputError(f"{path.name} cannot be read as a {path.suffix[1:]} mesh: {error}") from None
    faces = sum(len(mesh.faces) for _, mesh, _ in parts)
    if not 0 < faces <= _MAX_FACES:
        raise InputError(f"a vehicle's mesh has 1 to {_MAX_FACES} faces, {path.name} has {faces}")

    corners = [_corners(mesh, transform) for _, mesh, transform in parts]
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

    colors, normals = np.empty((SAMPLES, 3), np.uint8), np.empty((SAMPLES, 3))
    whole = np.empty(SAMPLES, bool)
    first = 0
    for (part, mesh, transform), own in zip(parts, corners, strict=True):
        here = (chosen >= first) & (chosen < first + len(own))
        spots = Spots(chosen[here] - first, weights[here])
        colors[here], whole[here] = paint(mesh, spots, path.name)
        if _GLASS.search(str(part)):
            colors[here] = np.minimum(colors[here], CABIN)
        normals[here] = _normals(mesh, transform, own, spots)
        first += len(own)
    if not whole.any():
        raise InputError(f"a vehicle's mesh is opaque somewhere, the materials of {path.name} cut all of it away")
    stated = Convention("m", "y", "z") if path.suffix.lower() in (".glb", ".gltf") else None
    return Surface(points[whole], colors[whole], normals[whole], triangles, chosen[whole], stated, tuple(remarks))


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
        missing += [t.strip() for t in re.findall(r"(?mi)^\s*map_Kd\s+(.+)$", text) if not _beside(path, t.strip())]
    return [f"not found beside it, left out: {', '.join(sorted(set(missing)))}"] if missing else []


def _distrust_gltf(path: Path, size: int) -> None:
    with path.open("rb") as file:
        if path.suffix.lower() == ".glb":
            head = file.read(20)
            magic, _, _, length, kind = struct.unpack("<4sIIII", head) if len(head) == 20 else (b"", 0, 0, 0, 0)
            if magic != b"glTF" or kind != 0x4E4F534A or length > size - 20:
                raise InputError(f"a .glb file begins with 'glTF' and a JSON chunk that fits, {path.name} does not")
            text = file.read(length)
        else:
            text = file.read()
    try:
        tree = json.loads(text)
        items = sum(int(accessor["count"]) for accessor in tree.get("accessors", []))
        links = [item["uri"] for kind in ("buffers", "images") for item in tree.get(kind, []) if "uri" in item]
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


def _normals(mesh: trimesh.Trimesh, transform: NDArray, corners: NDArray, spots: Spots) -> NDArray[np.float64]:
    """Unit normals [P, 3]: those of the vertices, but of the face where a vertex is the tip of an edge."""
    edges = corners[:, 1:] - corners[:, :1]
    flat = _unit(np.cross(edges[:, 0], edges[:, 1]))[spots.face, None]
    smooth = _unit(mesh.vertex_normals @ np.linalg.pinv(transform[:3, :3]))[mesh.faces[spots.face]]
    cosine = (smooth * flat).sum(-1, keepdims=True)
    smooth = np.where(np.abs(cosine) > _CREASE, smooth * np.sign(cosine), flat)
    return _unit(np.einsum("pc,pcd->pd", spots.weights, smooth))


def _unit(vectors: NDArray) -> NDArray[np.float64]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)
