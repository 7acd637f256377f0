"""Points to images the naive way: each colours the pixel it falls on. The paper's ablation of discs."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera, VehiclePoints
from dwgs.scene.pose import transform_points
from generator.conditions.raster import GREY


class PointProjector:
    """Draws one vehicle's points from anywhere, one pixel each, as `PointRasterizer` draws discs."""

    def __init__(self, vehicle: VehiclePoints) -> None:
        self._points, self._colors = vehicle.points, vehicle.colors

    def draw(
        self, camera: Camera, world_from_vehicle: NDArray[np.float64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """The point image [H, W, 3] and the point mask [H, W]; in each pixel the nearest point wins."""
        pixels, depths = camera.project(transform_points(world_from_vehicle, self._points))
        inside = np.flatnonzero((depths > 0) & camera.contains(pixels))
        far_first = inside[np.argsort(-depths[inside], kind="stable")]
        column, row = pixels[far_first].astype(np.int64).T
        image = np.full((camera.height, camera.width, 3), GREY, np.uint8)
        mask = np.zeros(image.shape[:2], bool)
        image[row, column], mask[row, column] = self._colors[far_first], True
        return image, mask
