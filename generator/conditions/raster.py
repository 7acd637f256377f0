"""Points to images: small discs, front to back, on a grey canvas (the point images of StreetCrafter)."""

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.scene import Camera, VehiclePoints
from generator.conditions import kernels

RADIUS = 0.005
"""Radius of a disc in NDC, where the shorter side of the image is 2: 1.2 px at 480 rows, at any depth."""

GREY = 127
"""Canvas without points: mid-grey, zero to a network that sees [-1, 1]."""

MASK_THRESHOLD = 0.5
"""A pixel belongs to the point mask where the discs cover more than this."""

_LEAST_RADIUS = 0.71  # px: a smaller disc may fall between all pixel centres and vanish
_STAMP = 1.5  # a point hides what is within so many spacings: random points leave no gap so wide
_BEHIND = 0.2  # m: points deeper than this behind the nearest are another side of the vehicle


class PointRasterizer:
    """Draws one vehicle's points from anywhere; `draw` may be called from several threads."""

    def __init__(self, vehicle: VehiclePoints) -> None:
        self._points = wp.array(np.ascontiguousarray(vehicle.points, np.float32), dtype=wp.vec3, device="cpu")
        self._colors = np.ascontiguousarray(vehicle.colors, np.float32)
        closed = vehicle.normals is not None and vehicle.is_complete
        normals = vehicle.normals if closed else np.zeros((1, 3))
        self._normals = wp.array(np.ascontiguousarray(normals, np.float32), dtype=wp.vec3, device="cpu")
        self._closed = closed
        self._reach = _STAMP * _spacing(vehicle.points)
        wp.load_module(kernels, device="cpu")  # here, not in a thread: loading is not safe there

    def draw(
        self, camera: Camera, world_from_vehicle: NDArray[np.float64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """The point image [H, W, 3] and the point mask [H, W] of the vehicle at a pose [4, 4]."""
        return blend(camera, *self.visible(camera, world_from_vehicle))

    def visible(
        self, camera: Camera, world_from_vehicle: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(u, v, depth) [P, 3] of the points that face the camera, at a pose [4, 4], and their colours [P, 3].

        What lies on the far side of the vehicle is left out: so small discs do not cover a near side.
        """
        camera_from_vehicle = camera.camera_from_world @ world_from_vehicle
        shape = (camera.height, camera.width)
        pixels = np.zeros((len(self._colors), 3), np.float32)
        pose = wp.mat44(camera_from_vehicle.astype(np.float32))
        K = wp.vec4(camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2])
        size = wp.vec2(camera.width, camera.height)
        inputs = [self._points, self._normals, self._closed, pose, K, size, _wrap(pixels, wp.vec3)]
        wp.launch(kernels.project, dim=len(pixels), inputs=inputs, device="cpu")

        drawn = np.flatnonzero(pixels[:, 2])
        pixels, colors = pixels[drawn], self._colors[drawn]
        nearest = np.full(shape, np.inf, np.float32)
        reach = self._reach * float(camera.K[0, 0])
        inputs = [_wrap(pixels, wp.vec3), _radius(camera), reach, _wrap(nearest, wp.float32)]
        wp.launch(kernels.find_nearest, dim=1, inputs=inputs, device="cpu")

        column, row = pixels[:, :2].astype(np.int64).T
        front = pixels[:, 2] <= nearest[row, column] + _BEHIND
        return pixels[front], colors[front]


def blend(
    camera: Camera, pixels: NDArray[np.float32], colors: NDArray[np.float32]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """The point image [H, W, 3] and the point mask [H, W] of discs at (u, v, depth) [P, 3] with colours [P, 3].

    A disc weighs ``1 - d^2 / r^2``; discs are blended front to back by depth of their centres.
    """
    shape = (camera.height, camera.width)
    front = np.argsort(pixels[:, 2], kind="stable")
    rgb = np.zeros((*shape, 3), np.float32)
    transmittance = np.ones(shape, np.float32)
    hits = np.zeros(shape, np.int32)
    inputs = [_wrap(pixels[front], wp.vec3), _wrap(colors[front], wp.vec3), _radius(camera)]
    inputs += [_wrap(rgb, wp.vec3), _wrap(transmittance, wp.float32), _wrap(hits, wp.int32)]
    wp.launch(kernels.blend, dim=1, inputs=inputs, device="cpu")
    image = np.rint(rgb + GREY * transmittance[..., None]).astype(np.uint8)
    return image, 1 - transmittance > MASK_THRESHOLD


def _radius(camera: Camera) -> float:
    """Of a disc [px]."""
    return max(0.5 * RADIUS * min(camera.width, camera.height), _LEAST_RADIUS)


def _spacing(points: NDArray) -> float:
    """Typical distance [m] between neighbouring points."""
    sample = points[:: max(len(points) // 2000, 1)]
    distances, _ = KDTree(points).query(sample, k=min(5, len(points)))
    return float(np.median(np.atleast_2d(distances)[:, -1]))


def _wrap(array: NDArray, dtype: type) -> wp.array:
    """The same memory, for a kernel."""
    return wp.array(array, dtype=dtype, device="cpu", copy=False)
