"""A picture of where a reconstruction fails."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.reconstruct.reconstruction import Reconstruction
from dwgs.scene import Scene

GAP = 6
"""White between the images [px]."""
FULL_ERROR = 0.25
"""A mean difference of the channels as large as this is drawn white."""


def picture_of_worst(reconstruction: Reconstruction, scene: Scene, report: dict[str, Any]) -> NDArray[np.uint8]:
    """The frames that `evaluate_whole` calls the worst, uint8 [H, W, 3]: recorded, rendered and their difference.

    A row for each, in that order; the difference is black where there is none.
    """
    frames = {(frame.camera_name, frame.index): frame for frame in scene.all_frames()}
    rows = []
    for entry in report["worst"]:
        frame = frames[entry["camera"], entry["frame"]]
        recorded, rendered = frame.pixels, np.clip(reconstruction.show(frame), 0, 1)
        error = np.abs(rendered - recorded / np.float32(255)).mean(-1, keepdims=True) / FULL_ERROR
        drawn = np.repeat(np.clip(error, 0, 1), 3, -1)
        images = [recorded, *((255 * image + 0.5).astype(np.uint8) for image in (rendered, drawn))]
        gap = np.full((len(recorded), GAP, 3), 255, np.uint8)
        rows.append(np.concatenate([images[0], gap, images[1], gap, images[2]], 1))
    width = max(row.shape[1] for row in rows)
    rows = [np.pad(row, ((0, GAP), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    return np.concatenate(rows)[:-GAP]
