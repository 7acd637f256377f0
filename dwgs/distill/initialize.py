"""Where the Gaussians of the body begin."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.distill.exposure import is_exposed, is_seen
from dwgs.scene import Gaussians, InputError, VehiclePoints
from dwgs.scene.pose import quat_from_rotation
from dwgs.splat.constants import SH_C0

NEIGHBOURS = 10
"""Points that say how dense the cloud is and which way it faces."""
MIRROR = np.array([1, -1, 1], np.float32)
"""Left is right."""
MIRROR_DISTANCE = 0.08
"""A mirrored point further [m] than this from every measured one fills a side that nobody saw."""
COARSER = 2.0
"""Discs that no camera sees lie so many times as far apart."""


def find_surface(vehicle: VehiclePoints, size: NDArray) -> VehiclePoints:
    """The points that show, of those in the box, grown by 10 %: not those of seats and of the insides of doors.

    A scan is mirrored about the plane y = 0 where only one side was seen. Raises `InputError` where all points lie
    outside the box.
    """
    points, colors, normals = vehicle.points, vehicle.colors, vehicle.normals
    if not vehicle.is_complete:
        points, colors, normals = _mirrored(points, colors, normals)
    within = np.flatnonzero((np.abs(points) <= 0.55 * np.asarray(size)).all(1))
    if len(within) == 0:
        raise InputError(
            f"a vehicle's points lie in its box of {np.round(size, 2)} m about the origin, "
            f"none of {len(points)} does; check the unit and the origin of the points"
        )
    shown = within[is_exposed(points[within])]
    return replace(
        vehicle, points=points[shown], colors=colors[shown], normals=None if normals is None else normals[shown]
    )


def initialize_body(surface: VehiclePoints, count: int, eyes: Sequence[NDArray]) -> Gaussians:
    """Discs on a vehicle's surface, at most ``count``, spaced evenly, with colours of degree 1.

    What none of the ``eyes`` [3] in the vehicle's frame sees gets fewer discs.
    """
    chosen, colors = _thinned(surface.points, surface.colors / np.float32(255), is_seen(surface.points, eyes), count)
    points, normals = surface.points[chosen], surface.normals

    tree = KDTree(points)
    neighbours = min(NEIGHBOURS, len(points))
    distances, indices = tree.query(points, neighbours)
    distances, indices = distances.reshape(len(points), -1), indices.reshape(len(points), -1)
    spacing = np.clip(distances[:, 1:5].mean(1) if neighbours > 1 else np.full(len(points), 0.05), 0.005, 0.2)
    if normals is None:
        axes, flatness = _principal_axes(points, indices)
    else:
        axes, flatness = _axes_about(normals[chosen]), np.full(len(points), 0.1)
    scales = np.stack([0.7 * spacing, 0.7 * spacing, 0.7 * spacing * flatness], 1)

    sh = np.zeros((len(points), 4, 3), np.float32)
    sh[:, 0] = (colors - 0.5) / SH_C0
    return Gaussians(
        points.astype(np.float32),
        quat_from_rotation(axes).astype(np.float32),
        scales.astype(np.float32),
        np.full(len(points), 0.7, np.float32),
        sh,
    )


def _mirrored(points, colors, normals):
    """The cloud and those of its mirror images that lie where it has nothing."""
    images = points * MIRROR
    fresh = KDTree(points).query(images, distance_upper_bound=MIRROR_DISTANCE)[0] > MIRROR_DISTANCE
    points, colors = np.concatenate([points, images[fresh]]), np.concatenate([colors, colors[fresh]])
    if normals is not None:
        normals = np.concatenate([normals, normals[fresh] * MIRROR])
    return points, colors, normals


def _thinned(points, colors, seen, count):
    """One point per voxel, the first, with the mean colour; voxels as small as ``count`` allows."""
    x, y, z = points.T / np.where(seen, 1, COARSER)

    def cells(voxel: float) -> NDArray:
        i, j, k = (np.floor(a / voxel).astype(np.int64) + (1 << 19) for a in (x, y, z))
        return (seen.astype(np.int64) << 60) | (i << 40) | (j << 20) | k

    if len(points) <= count:
        return np.arange(len(points)), colors
    low, high = 1e-3, 1.0
    for _ in range(12):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if len(np.unique(cells(middle))) > count else (low, middle)
    _, first, voxel_of_point = np.unique(cells(high), return_index=True, return_inverse=True)
    sums = np.stack([np.bincount(voxel_of_point, channel) for channel in colors.T], 1)
    return first, sums / np.bincount(voxel_of_point)[:, None]


def _principal_axes(points, indices):
    """Rotations [N, 3, 3] whose last column is the normal of each neighbourhood, and how flat each is [N]."""
    around = points[indices] - points[indices].mean(1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around).astype(np.float64))
    axes = axes[:, :, ::-1].copy()
    axes[np.linalg.det(axes) < 0, :, 2] *= -1
    ratio = np.sqrt(np.maximum(spread[:, 0], 0) / np.maximum(spread[:, 1], 1e-12))
    return axes, np.clip(ratio, 0.1, 1.0)


def _axes_about(normals):
    """Rotations [N, 3, 3] whose last column is the given direction."""
    z = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    steepest = np.eye(3)[np.abs(z).argmin(1)]
    x = np.cross(steepest, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], -1)
