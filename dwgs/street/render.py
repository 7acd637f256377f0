"""Pictures of a stage: bytes, depth, and how much of each pixel the last body covers."""

from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dwgs.scene.camera import Camera
from dwgs.street import kernels
from dwgs.street.world import Stage, transforms

ROWS = 24
"""Image rows that a thread renders at a time."""
SUN_RADIUS = 0.006
"""Radius of the sun's disc as seen [rad]: softens shadows where they are sampled finely."""


def _pattern() -> NDArray[np.float32]:
    """[8, 4] eight rooks over the pixel (x, y), the first four evenly too; and as many places on the sun."""
    place = np.array([(0, 2), (2, 7), (5, 0), (7, 5), (1, 4), (3, 1), (4, 6), (6, 3)])
    turn, reach = 2.4 * np.arange(8), SUN_RADIUS * np.sqrt((np.arange(8) + 0.5) / 8)  # a sunflower
    sun = np.column_stack([reach * np.cos(turn), reach * np.sin(turn)])
    return np.concatenate([(place + 0.5) / 8, sun], 1).astype(np.float32)


PATTERN = _pattern()


@dataclass(frozen=True)
class Picture:
    """What a camera sees."""

    pixels: NDArray[np.uint8]
    """[H, W, 3] sRGB."""
    share: NDArray[np.uint8]
    """[H, W] how much of the pixel the last body covers, of 255."""


def render(stage: Stage, camera: Camera, only: int = -1, executor: Executor | None = None) -> Picture:
    """The stage at the camera's time.

    ``only`` names the one body to draw (on grey 127), lit as in the street. With an executor its threads
    share the rows; the bytes are the same.
    """
    height, width = camera.height, camera.width
    world, eye = stage.at(camera.time, camera.position), _eye(camera, only)
    colors = wp.empty((height, width), dtype=wp.vec3, device="cpu")  # pyright: ignore[reportArgumentType]
    ranges = wp.empty((height, width), dtype=float, device="cpu")
    bodies, kinds = (wp.empty((height, width), dtype=int, device="cpu") for _ in range(2))
    pixels, share = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.uint8)
    seen = [colors, ranges, bodies, kinds]
    written = [wp.array(a, device="cpu", copy=False) for a in (pixels, share)]
    pattern = wp.array(PATTERN, dtype=wp.vec4, device="cpu")
    _launch(kernels.draw, (height, width), [world, eye], seen, executor)
    _launch(kernels.refine, (height, width), [world, eye], [pattern, *seen, *written], executor)
    return Picture(pixels, share)


def render_depth(stage: Stage, camera: Camera, only: int = -1) -> NDArray[np.float32]:
    """z-depth [H, W] [m] at the pixel centres, infinite in the sky."""
    depth = np.empty((camera.height, camera.width), np.float32)
    output = wp.array(depth, device="cpu", copy=False)
    inputs = [stage.at(camera.time), _eye(camera, only)]
    _launch(kernels.measure_depth, depth.shape, inputs, [output], None)
    return depth


def _launch(kernel: Any, shape: tuple[int, ...], inputs: list, outputs: list, executor: Executor | None) -> None:
    """Runs a kernel over all rows: at once, or a few at a time on the threads of an executor."""

    def run(first: int, count: int) -> None:
        wp.launch(kernel, (count, shape[1]), [*inputs, first, *outputs], device="cpu", record_tape=False)

    if executor is None:
        run(0, shape[0])
        return
    for job in [executor.submit(run, first, min(ROWS, shape[0] - first)) for first in range(0, shape[0], ROWS)]:
        job.result()


def _eye(camera: Camera, only: int) -> Any:
    eye = kernels.Eye()
    eye.pose = wp.transform(*transforms(camera.world_from_camera[None]).numpy()[0])
    eye.fx, eye.fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    eye.cx, eye.cy = float(camera.K[0, 2]), float(camera.K[1, 2])
    eye.only = only
    return eye
