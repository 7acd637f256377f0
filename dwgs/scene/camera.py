"""A pinhole camera at one instant."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.pose import inverse, is_rigid, transform_points


@dataclass(frozen=True)
class Camera:
    """Pinhole, OpenCV axes (x right, y down, z forward), pixel centres at +0.5, no distortion."""

    K: NDArray[np.float64]
    """[3, 3] intrinsics [px]."""
    width: int
    """Image width [px]."""
    height: int
    """Image height [px]."""
    world_from_camera: NDArray[np.float64]
    """[4, 4] pose; z of the world is up [m]."""
    time: float
    """Exposure [s], on the recording's clock."""

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError(f"an image has at least one pixel, this camera says {self.width}x{self.height}")
        if np.shape(self.K) != (3, 3) or not np.isfinite(self.K).all() or self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise InputError(f"intrinsics are a finite 3x3 matrix with positive focal lengths, got {self.K!r}")
        if not is_rigid(self.world_from_camera):
            raise InputError(f"a camera pose is a rotation and a translation, got {self.world_from_camera!r}")

    @property
    def camera_from_world(self) -> NDArray[np.float64]:
        """[4, 4]."""
        return inverse(self.world_from_camera)

    @property
    def position(self) -> NDArray[np.float64]:
        """[3] optical centre in the world [m]."""
        return self.world_from_camera[:3, 3]

    def project(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """World points [N, 3] to pixels [N, 2] and z-depths [N] [m]; pixels mean nothing where depth <= 0."""
        p = transform_points(self.camera_from_world, points)
        depth = p[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (p @ self.K.T)[:, :2] / depth[:, None]
        return pixels, depth

    def contains(self, pixels: NDArray[np.floating]) -> NDArray[np.bool_]:
        """[N] which pixels [N, 2] lie in the image; those that are no numbers do not."""
        x, y = pixels.T
        with np.errstate(invalid="ignore"):
            return (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)

    def may_see(self, points: ArrayLike, margin: float = 1.0) -> NDArray[np.bool_]:
        """[N] which world points [N, 3] may fall into the image or ``margin`` [px] around it: quick, in float32."""
        pixels_from_world = (self.K @ self.camera_from_world[:3]).astype(np.float32)
        x, y, depth = pixels_from_world[:, :3] @ np.asarray(points, np.float32).T + pixels_from_world[:, 3:]
        right, bottom = (self.width + margin) * depth, (self.height + margin) * depth
        return (depth > 0) & (x > -margin * depth) & (x < right) & (y > -margin * depth) & (y < bottom)

    def crop(self, x: int, y: int, width: int, height: int) -> "Camera":
        """The camera that sees only the given window [px] of this one's image."""
        K = self.K.copy()
        K[:2, 2] -= (x, y)
        return replace(self, K=K, width=width, height=height)

    def resize(self, width: int, height: int) -> "Camera":
        """The same view sampled with another number of pixels."""
        K = np.diag([width / self.width, height / self.height, 1]) @ self.K
        return replace(self, K=K, width=width, height=height)

    def at(self, world_from_camera: NDArray[np.float64]) -> "Camera":
        """The same camera somewhere else."""
        return replace(self, world_from_camera=world_from_camera)
