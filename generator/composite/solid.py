"""A closed solid from what a scanner saw of a vehicle.

A LiDAR sees one side, looks through the glass and stops short of the ground. What it misses follows from what
vehicles have in common: they are symmetric, a cross-section is convex above the sills (the glass is the straight
line from belt to roof rail), they fill their box, and they stand on four wheels. So the solid is a half width over
the side view, and four tyres.
"""

from dataclasses import dataclass

import numpy as np
import pyvista
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d, median_filter
from scipy.spatial import KDTree

VOXEL = 0.03
"""Grid step of the solid [m]: about what aggregated sweeps resolve."""
ISOLATION_RADIUS, ISOLATION_COUNT = 0.12, 8
"""A point with no more neighbours than that within that distance [m] is spray or a mirror image."""
ISO = 0.4987
"""Occupancy of the boundary: about one half, but no value that a cell of a flat side takes exactly."""
MIRROR_WIDTH = 0.57
"""What juts out of the side over less than half of this length [m] is a mirror, not the body."""
TYRE_WIDTH = 0.22
"""[m]."""


@dataclass(frozen=True)
class Wheel:
    """A tyre: a cylinder about the vehicle's y axis, and its image on the other side."""

    x: float
    """Hub along the vehicle [m]."""
    z: float
    """Hub above the box centre [m]."""
    radius: float
    """[m]."""
    outside: float
    """Distance of the outer face from the middle plane [m]."""


@dataclass(frozen=True)
class Solid:
    """A watertight triangle mesh, and its wheels."""

    vertices: NDArray[np.float64]
    """[V, 3] vehicle frame [m]."""
    normals: NDArray[np.float64]
    """[V, 3] unit, outward."""
    faces: NDArray[np.int64]
    """[F, 3]."""
    wheels: tuple[Wheel, ...]
    """Front and rear."""


def solid_from_scan(points: NDArray, size: NDArray) -> Solid:
    """The solid that points [P, 3] of a vehicle of ``size`` [3] suggest; they may cover one side alone."""
    half = symmetric_half(points, size)
    width, xs, zs = half_width(half, size)
    width = fill_ends(width, half, xs, size)
    bottom, wheels = undercarriage(width, half, xs, zs, size)
    width = np.where(zs[None, :] >= bottom[:, None], width, 0)
    return _contour(width, xs, zs, wheels, size)


def symmetric_half(points: NDArray, size: NDArray) -> NDArray[np.float64]:
    """The better covered half of the points [P, 3], without strays, folded to y >= 0.

    Coverage counts cells, not points: one near sweep puts thousands of points on one fender.
    """
    points = np.asarray(points, np.float64)
    company = KDTree(points).query_ball_point(points, ISOLATION_RADIUS, return_length=True) > ISOLATION_COUNT
    points = points[company & (np.abs(points) <= np.asarray(size) / 2 + VOXEL).all(1)]
    cells = np.unique(np.round(points / (2 * VOXEL)).astype(np.int64), axis=0)
    side = 1 if (cells[:, 1] > 0).sum() >= (cells[:, 1] < 0).sum() else -1
    return points[points[:, 1] * side >= 0] * (1, side, 1)


def half_width(half: NDArray, size: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Half width [X, Z] [m] over the side view, and its cell centres along x and z; 0 outside.

    Each cross-section is the least concave majorant of its points: glass that returned nothing is bridged,
    seats behind it fall inside. A median along x takes the mirrors off; what juts out comes back cell by cell.
    """
    length, _, height = size
    xs = np.arange(-length / 2 - 4 * VOXEL, length / 2 + 4 * VOXEL, VOXEL)
    zs = np.arange(-height / 2 - 4 * VOXEL, height / 2 + 4 * VOXEL, VOXEL)
    width = np.zeros((len(xs), len(zs)))
    half = half[np.argsort(half[:, 0])]
    for i, x in enumerate(xs):
        section = half[slice(*np.searchsorted(half[:, 0], (x - VOXEL, x + VOXEL))), 1:]
        if len(section) < 6:
            continue
        low, high = np.quantile(section[:, 1], (0.01, 0.995))
        knots = concave_majorant(section[:, 1], section[:, 0])
        inside = (zs >= low - VOXEL / 2) & (zs <= high + VOXEL / 2)
        width[i, inside] = np.interp(zs[inside], knots[:, 0], knots[:, 1])
    body = _fair(width, zs)
    jut = half[half[:, 2] > 0]
    i, k = np.searchsorted(xs, jut[:, 0] - VOXEL / 2), np.searchsorted(zs, jut[:, 2] - VOXEL / 2)
    i, k = np.minimum(i, len(xs) - 1), np.minimum(k, len(zs) - 1)
    out = jut[:, 1] > body[i, k] + 2 * VOXEL
    np.maximum.at(body, (i[out], k[out]), jut[out, 1])
    return body, xs, zs


def _fair(width: NDArray, zs: NDArray) -> NDArray[np.float64]:
    """Width [X, Z] without mirrors and ripples; the outline of the side view is smoothed as well."""
    occupied = np.any(width > 0, axis=1)
    top = np.where(occupied, zs[width.shape[1] - 1 - (width > 0)[:, ::-1].argmax(1)], zs[0] - VOXEL)
    top = gaussian_filter1d(median_filter(top, 9, mode="nearest"), 2.0, mode="nearest")
    highest = np.where(width > 0, zs, -np.inf).argmax(1)
    held = np.where(np.arange(len(zs)) > highest[:, None], width[np.arange(len(width)), highest][:, None], width)
    median = median_filter(held, (round(MIRROR_WIDTH / VOXEL) | 1, 1), mode="nearest")
    held = np.where(median > 0, np.minimum(held, median), held)
    present = (held > 0) & (zs <= top[:, None] + VOXEL / 2) & occupied[:, None]
    weight = gaussian_filter(present.astype(float), (3, 2))
    return np.where(present, gaussian_filter(held * present, (3, 2)) / np.maximum(weight, 1e-9), 0)


def fill_ends(width: NDArray, half: NDArray, xs: NDArray, size: NDArray) -> NDArray[np.float64]:
    """Width [X, Z] with an end that no point lies on continued to the end of the box, rounded off."""
    length, breadth, height = size
    width = width.copy()
    tall = np.flatnonzero((width > 0).sum(1) * VOXEL > 0.3 * height)
    if len(tall) == 0:
        return width
    for sign, last in ((-1, tall[0]), (1, tall[-1])):
        reach = length / 2 - sign * xs[last]
        if reach < 2 * VOXEL:
            continue
        face = half[(half[:, 0] * sign > length / 2 - reach - 0.1) & (half[:, 1] < 0.3 * breadth)]
        seen = len(np.unique(np.round(face[:, 1:] / (3 * VOXEL)), axis=0)) * (3 * VOXEL) ** 2
        if seen > 0.1 * (0.3 * breadth * height):
            continue
        beyond = np.flatnonzero(sign * (xs - xs[last]) >= 0)
        s = np.abs(xs[beyond] - xs[last]) / reach
        rounded = np.where(s < 0.97, np.sqrt(np.clip(1 - 0.35 * s**3, 0, 1)), 0)
        width[beyond] = np.where(s[:, None] < 0.97, np.maximum(width[beyond], width[last] * rounded[:, None]), 0)
    return width


def undercarriage(
    width: NDArray, half: NDArray, xs: NDArray, zs: NDArray, size: NDArray
) -> tuple[NDArray[np.float64], tuple[Wheel, ...]]:
    """Height [X] [m] below which there is no body, and the wheels that carry it.

    A wheel is where the outer side reaches lowest: scans end a little above the ground, sills higher.
    """
    length, breadth, height = size
    ground = -height / 2
    radius = float(np.clip(0.2 * height, 0.29, 0.5))
    low = half[(half[:, 2] < ground + 0.65 * radius) & (half[:, 1] > 0.36 * breadth)]
    counts = np.zeros(len(xs))
    cells = np.unique(np.round(low / VOXEL).astype(np.int64)[:, [0, 2]], axis=0)[:, 0] * VOXEL
    np.add.at(counts, np.clip(np.searchsorted(xs, cells - VOXEL / 2), 0, len(xs) - 1), 1)
    counts = gaussian_filter1d(counts, 0.6 * radius / VOXEL) + 1e-3
    wheels = []
    for sign in (1, -1):
        belief = counts * np.exp(-0.5 * ((xs * sign - 0.29 * length) / (0.06 * length)) ** 2)
        i = int(np.argmax(belief))
        k = np.searchsorted(zs, ground + radius)
        outside = np.clip(np.median(width[max(i - 8, 0) : i + 9, k]), 0.42 * breadth, breadth / 2) - 0.01
        wheels.append(Wheel(float(xs[i]), ground + radius, radius, float(outside)))
    lowest = np.where((width > 0).any(1), zs[(width > 0).argmax(1)], np.inf)
    clearance = ground + float(np.clip(0.13 * height, 0.18, 0.4))
    near_wheel = np.min([np.abs(xs - w.x) for w in wheels], axis=0) < 1.35 * radius
    trusted = ~near_wheel & np.isfinite(lowest)
    bottom = np.interp(xs, xs[trusted], lowest[trusted]) if trusted.any() else np.full(len(xs), clearance)
    bottom = gaussian_filter1d(median_filter(np.clip(bottom, clearance, ground + 0.45), 15, mode="nearest"), 4)
    return bottom, tuple(wheels)


def concave_majorant(x: NDArray, y: NDArray) -> NDArray[np.float64]:
    """The knots [K, 2] of the smallest concave function that is nowhere below the points (x [P], y [P])."""
    order = np.lexsort((-y, x))
    hull: list[tuple[float, float]] = []
    for p in zip(x[order].tolist(), y[order].tolist(), strict=True):
        if hull and p[0] == hull[-1][0]:
            continue
        while len(hull) > 1 and _cross(hull[-2], hull[-1], p) >= 0:
            hull.pop()
        hull.append(p)
    return np.array(hull)


def _cross(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _contour(width: NDArray, xs: NDArray, zs: NDArray, wheels: tuple[Wheel, ...], size: NDArray) -> Solid:
    """The smoothed boundary of the solid, by marching over its occupancy."""
    count = int(np.ceil((width.max() + 5 * VOXEL) / VOXEL))
    ys = np.arange(-count, count + 1) * VOXEL
    occupancy = np.clip((width[:, None, :] - np.abs(ys)[None, :, None]) / VOXEL + 0.5, 0, 1)
    occupancy = gaussian_filter(np.where(width[:, None, :] > 0, occupancy, 0), 1.8)
    for wheel in wheels:
        distance = np.hypot(xs[:, None] - wheel.x, zs[None, :] - wheel.z)[:, None, :]
        across = np.abs(np.abs(ys) - wheel.outside + TYRE_WIDTH / 2)[None, :, None] - TYRE_WIDTH / 2
        tyre = np.clip(0.5 - np.maximum(distance - wheel.radius, across) / (2 * VOXEL), 0, 1)
        occupancy = np.maximum(occupancy, tyre)
    image = pyvista.ImageData(dimensions=occupancy.shape, spacing=(VOXEL,) * 3, origin=(xs[0], ys[0], zs[0]))
    image["occupancy"] = occupancy.ravel(order="F")
    mesh = image.contour([ISO], "occupancy").connectivity("largest").triangulate()
    gradient = np.stack([np.gradient(gaussian_filter(occupancy, 1.5), VOXEL, axis=k) for k in range(3)], -1)
    vertices = np.asarray(mesh.points, np.float64)
    cells = np.clip(np.round((vertices - image.origin) / VOXEL).astype(int), 0, np.array(occupancy.shape) - 1)
    normals = -gradient[tuple(cells.T)]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    vertices[:, 2] = np.maximum(vertices[:, 2], -size[2] / 2)
    return Solid(vertices, normals, np.asarray(mesh.regular_faces, np.int64), wheels)
