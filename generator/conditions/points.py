"""A vehicle from a file: coloured points in its own frame, its size, and what was assumed."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import InputError, VehiclePoints
from generator.conditions import axes, cloud, mesh
from generator.conditions.aggregate import points_of_track as points_of_track
from generator.conditions.outside import seen_from_outside
from generator.conditions.surface import Surface

_GREY = 127
_BOX_SLACK = 0.02  # m: a stated box is rounded
_CLEARANCE = (0.05, 0.40)  # between a body without wheels and the ground of its own frame [m]


def load_vehicle(
    path: Path, unit: str | None = None, forward: str | None = None
) -> tuple[VehiclePoints, NDArray[np.float64], str]:
    """Points of a vehicle, its size [3] (length, width, height) [m], and one line about what was assumed.

    Args:
        path: A mesh (glTF, GLB, OBJ, PLY, STL, OFF), a coloured cloud (PLY), or an asset folder.
        unit: Unit of the file (m, cm, mm, inch, feet); by default what the format states, else what fits.
        forward: Axis of the file along which it drives (x, -x, y, -y, z, -z); by default likewise.

    Raises:
        InputError: It cannot be read, or is no vehicle in any unit.
    """
    path = Path(path)
    if path.is_dir():
        return _from_asset(path)
    if not path.is_file():
        raise InputError(f"a vehicle is a mesh, a point cloud or an asset folder, there is none at {path}")
    if path.suffix.lower() not in mesh.SUFFIXES:
        raise InputError(f"a vehicle's file is one of {', '.join(mesh.SUFFIXES)}, not {path.name}; convert it")
    if path.suffix.lower() == ".ply":
        header = cloud.read_header(path)
        if header.faces == 0:
            if header.box is not None and unit is None and forward is None:
                return _from_box(path, header.box)
            return _from_surface(path, _cloud_surface(path), unit, forward)
    return _from_surface(path, mesh.sample_mesh(path), unit, forward)


def _from_surface(
    path: Path, surface: Surface, unit: str | None, forward: str | None
) -> tuple[VehiclePoints, NDArray[np.float64], str]:
    convention, assumed = axes.convention_of(surface, path.name, unit, forward)
    turn = axes.matrix(convention)
    solid = surface.points if surface.triangles is None else surface.triangles.reshape(-1, 3)
    low, high = (solid @ turn.T).min(0), (solid @ turn.T).max(0)
    remarks = list(surface.remarks)
    if surface.triangles is not None and _CLEARANCE[0] < low[2] < _CLEARANCE[1]:
        remarks.append(f"it ends {100 * low[2]:.0f} cm above its own zero, taken for the ground (has it no wheels?)")
        low[2] = 0.0
    size, center = high - low, (low + high) / 2
    points = surface.points @ turn.T - center
    colors, normals = surface.colors, surface.normals
    if surface.triangles is not None and surface.face is not None and normals is not None:
        normals = normals @ turn.T
        normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
        side = seen_from_outside(points, surface.face, surface.triangles @ turn.T - center)
        if not side.any():
            raise InputError(f"no face of {path.name} can be seen from outside; repair the mesh")
        points, colors, normals = points[side != 0], colors[side != 0], (normals * side[:, None])[side != 0]
    vehicle = VehiclePoints(
        points.astype(np.float32),
        colors,
        None if normals is None else normals.astype(np.float32),
        is_complete=surface.triangles is not None,
    )
    note = "; ".join([f"{path.name}: {axes.describe(convention, size, assumed)}", *remarks])
    return vehicle, size, note


def _cloud_surface(path: Path) -> Surface:
    points, colors, normals = cloud.read_cloud(path)
    if colors is None:
        return Surface(points, np.full(points.shape, _GREY, np.uint8), normals, remarks=("no colours, drawn grey",))
    return Surface(points, colors, normals)


def _from_box(path: Path, size: NDArray[np.float64]) -> tuple[VehiclePoints, NDArray[np.float64], str]:
    """A scan that states its box is in the box's frame already."""
    surface = _cloud_surface(path)
    low, high = np.quantile(surface.points, [0.01, 0.99], axis=0)
    if (size <= 0).any() or (np.maximum(-low, high) > 0.6 * size + 0.1).any():
        raise InputError(
            f"{path.name} states a box of {' x '.join(f'{s:.2f}' for s in size)} m but its points reach from "
            f"{np.round(low, 2)} to {np.round(high, 2)}; correct the comment or set --unit and --forward"
        )
    inside = (np.abs(surface.points) <= size / 2 + _BOX_SLACK).all(1)
    normals = None if surface.normals is None else surface.normals[inside].astype(np.float32)
    vehicle = VehiclePoints(surface.points[inside].astype(np.float32), surface.colors[inside], normals)
    words = f"{path.name}: states its box ({' x '.join(f'{s:.2f}' for s in size)} m), metres, up +z, forward +x"
    return vehicle, size, "; ".join([words, *surface.remarks])


def _from_asset(path: Path) -> tuple[VehiclePoints, NDArray[np.float64], str]:
    from dwgs.formats import asset_folder

    asset = asset_folder.read(path)
    body = asset.body[asset.body.opacities > 0.3]
    if len(body) == 0:
        raise InputError(f"an asset has a body, that of {path} has no Gaussian of opacity over 0.3")
    dc = 0.5 + 0.28209479177387814 * body.sh[:, 0]  # spherical harmonics of degree 0
    colors = np.rint(255 * dc.clip(0, 1)).astype(np.uint8)
    vehicle = VehiclePoints(body.means, colors)
    return (
        vehicle,
        np.asarray(asset.size, np.float64),
        f"{path.name}: an asset, {len(body)} Gaussians as points",
    )
