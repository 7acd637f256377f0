"""What one run of the network is told, in pixels: NumPy only."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from generator.conditions.conditions import ConditionFrame
from generator.conditions.raster import GREY


@dataclass(frozen=True)
class Clip:
    """Frames of a recording, with the conditions of each."""

    video: NDArray[np.uint8]
    """[T, H, W, 3] sRGB as recorded."""
    reactive_mask: NDArray[np.bool_]
    """[T, H, W] where the network may paint."""
    point_image: NDArray[np.uint8]
    """[T, H, W, 3] sRGB points, or pixels that are given, on a mid-grey canvas."""
    point_mask: NDArray[np.bool_]
    """[T, H, W] where the point image says something."""

    @staticmethod
    def of(frames: Sequence[ConditionFrame]) -> "Clip":
        """Read the conditions of some frames."""
        return Clip(
            np.stack([f.frame.pixels for f in frames]),
            np.stack([f.load_reactive_mask() for f in frames]),
            np.stack([f.load_point_image() for f in frames]),
            np.stack([f.load_point_mask() for f in frames]),
        )

    def given(self, images: dict[int, NDArray[np.uint8]]) -> "Clip":
        """The same with whole images [H, W, 3] in place of the points at some positions: the paper's GT-aware mode.

        There, the vehicle's region shows the given pixels and its point mask is dense; other frames keep their
        points, and no reactive mask changes: what is given guides, it is not recorded.
        """
        point_image, point_mask = self.point_image.copy(), self.point_mask.copy()
        for at, image in images.items():
            region = self.reactive_mask[at]
            point_image[at] = np.where(region[..., None], image, np.uint8(GREY))
            point_mask[at] = region
        return replace(self, point_image=point_image, point_mask=point_mask)

    def restored(self, generated: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Generated pixels [T, H, W, 3] inside the reactive masks, the recorded ones, bit for bit, around."""
        return np.where(self.reactive_mask[..., None], generated, self.video)
