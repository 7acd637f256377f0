"""Points to images: small discs, front to back, on a grey canvas (the point images of StreetCrafter)."""

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dwgs.scene import Camera, VehiclePoints

RADIUS = 0.005
"""Radius of a disc in NDC, where the shorter side of the image is 2: 1.2 px at 480 rows, at any depth."""

GREY = 127
"""Canvas without points: mid-grey, zero to a network that sees [-1, 1]."""

MASK_THRESHOLD = 0.5
"""A pixel belongs to the point mask where the discs cover more than this."""

_LEAST_RADIUS = 0.71  # px: a smaller disc may fall between all pixel centres and vanish
_MOST_HITS = 10  # discs per pixel
_LEAST_ALPHA = 1 / 255
_OPAQUE = 1e-4  # transmittance
_NEAR = 0.1  # m
_BEHIND = 0.2  # m: points deeper than this behind the nearest are another side of the vehicle
_LARGEST_STAMP = 12.0  # px

wp.config.log_level = wp.LOG_ERROR  # standard output belongs to the command line


class PointRasterizer:
    """Draws one vehicle's points from anywhere; `draw` may be called from several threads."""

    def __init__(self, vehicle: VehiclePoints) -> None:
        self._points = wp.array(np.ascontiguousarray(vehicle.points, np.float32), dtype=wp.vec3, device="cpu")
        self._colors = np.ascontiguousarray(vehicle.colors, np.float32)
        closed = vehicle.normals is not None and vehicle.is_complete
        normals = vehicle.normals if closed else np.zeros((1, 3))
        self._normals = wp.array(np.ascontiguousarray(normals, np.float32), dtype=wp.vec3, device="cpu")
        self._closed = closed
        self._spacing = _spacing(vehicle.points)
        wp.load_module(__name__, device="cpu")  # here, not in a thread: loading is not safe there

    def draw(
        self, camera: Camera, world_from_vehicle: NDArray[np.float64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """The point image [H, W, 3] and the point mask [H, W] of the vehicle at a pose [4, 4].

        A disc weighs ``1 - d^2 / r^2``; discs are blended front to back by depth of their centres. What lies on the
        far side of the vehicle is left out first: so small discs do not cover a near side.
        """
        camera_from_vehicle = camera.camera_from_world @ world_from_vehicle
        radius = max(0.5 * RADIUS * min(camera.width, camera.height), _LEAST_RADIUS)
        size = (camera.height, camera.width)
        pixels = np.zeros((len(self._colors), 3), np.float32)
        nearest = np.full(size, np.inf, np.float32)
        K = wp.vec4(camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2])
        _launch(
            _project,
            len(pixels),
            self._points, self._normals, self._closed, wp.mat44(camera_from_vehicle.astype(np.float32)), K,
            _wrap(pixels, wp.vec3),
        )  # fmt: skip
        _launch(
            _find_nearest,
            1,
            _wrap(pixels, wp.vec3),
            radius,
            self._spacing * float(camera.K[0, 0]),
            _wrap(nearest, wp.float32),
        )

        seen = np.flatnonzero(pixels[:, 2] > 0)
        column = pixels[seen, 0].astype(np.int64).clip(0, camera.width - 1)
        row = pixels[seen, 1].astype(np.int64).clip(0, camera.height - 1)
        seen = seen[pixels[seen, 2] <= nearest[row, column] + _BEHIND]
        seen = seen[np.argsort(pixels[seen, 2], kind="stable")]

        rgb = np.zeros((*size, 3), np.float32)
        transmittance = np.ones(size, np.float32)
        _launch(
            _blend,
            1,
            _wrap(pixels[seen], wp.vec3), _wrap(self._colors[seen], wp.vec3), radius,
            _wrap(rgb, wp.vec3), _wrap(transmittance, wp.float32),
            _wrap(np.zeros(size, np.int32), wp.int32),
        )  # fmt: skip
        image = np.rint(rgb + GREY * transmittance[..., None]).astype(np.uint8)
        return image, 1 - transmittance > MASK_THRESHOLD


def _spacing(points: NDArray) -> float:
    """Typical distance [m] between neighbouring points."""
    sample = points[:: max(len(points) // 2000, 1)]
    distances, _ = cKDTree(points).query(sample, k=min(5, len(points)))
    return float(np.median(np.atleast_2d(distances)[:, -1]))


def _wrap(array: NDArray, dtype: type) -> wp.array:
    return wp.array(np.ascontiguousarray(array), dtype=dtype, device="cpu", copy=False)


def _launch(kernel: wp.Kernel, count: int, *inputs) -> None:
    wp.launch(kernel, dim=count, inputs=list(inputs), device="cpu")


@wp.kernel
def _project(
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    closed: bool,
    camera_from_vehicle: wp.mat44,
    K: wp.vec4,
    pixels: wp.array(dtype=wp.vec3),
):
    """(u, v, depth) of each point; depth 0 where it is behind the camera or on a side turned away."""
    i = wp.tid()
    p = wp.transform_point(camera_from_vehicle, points[i])
    if p[2] < _NEAR:
        return
    if closed and wp.dot(wp.transform_vector(camera_from_vehicle, normals[i]), p) >= 0.0:
        return
    pixels[i] = wp.vec3(K[0] * p[0] / p[2] + K[2], K[1] * p[1] / p[2] + K[3], p[2])


@wp.kernel
def _find_nearest(
    pixels: wp.array(dtype=wp.vec3), radius: float, spacing: float, nearest: wp.array2d(dtype=float)
):
    """Depth of the nearest surface; points are stamped so wide that their neighbours' stamps touch. One thread."""
    for i in range(pixels.shape[0]):
        p = pixels[i]
        if p[2] > 0.0:
            reach = wp.min(wp.max(radius, spacing / p[2]), _LARGEST_STAMP)
            for y in range(wp.max(int(p[1] - reach), 0), wp.min(int(p[1] + reach) + 1, nearest.shape[0])):
                for x in range(wp.max(int(p[0] - reach), 0), wp.min(int(p[0] + reach) + 1, nearest.shape[1])):
                    nearest[y, x] = wp.min(nearest[y, x], p[2])


@wp.kernel
def _blend(
    pixels: wp.array(dtype=wp.vec3),
    colors: wp.array(dtype=wp.vec3),
    radius: float,
    rgb: wp.array2d(dtype=wp.vec3),
    transmittance: wp.array2d(dtype=float),
    hits: wp.array2d(dtype=int),
):
    """Discs in order of depth over each other. One thread: the order is the result."""
    for i in range(pixels.shape[0]):
        p = pixels[i]
        for y in range(wp.max(int(p[1] - radius), 0), wp.min(int(p[1] + radius) + 1, rgb.shape[0])):
            for x in range(wp.max(int(p[0] - radius), 0), wp.min(int(p[0] + radius) + 1, rgb.shape[1])):
                dx = float(x) + 0.5 - p[0]
                dy = float(y) + 0.5 - p[1]
                alpha = 1.0 - (dx * dx + dy * dy) / (radius * radius)
                left = transmittance[y, x]
                if alpha >= _LEAST_ALPHA and left >= _OPAQUE and hits[y, x] < _MOST_HITS:
                    rgb[y, x] = rgb[y, x] + alpha * left * colors[i]
                    transmittance[y, x] = left * (1.0 - alpha)
                    hits[y, x] = hits[y, x] + 1
