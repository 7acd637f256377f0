"""Pictures of a stage: bytes, depth, and the share of each pixel that the last body covers."""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dwgs.scene.camera import Camera
from dwgs.street import raycast
from dwgs.street.raycast import Eye
from dwgs.street.world import Stage, in_chunks, transforms

ROWS = 24
"""Image rows that a thread renders at a time."""
SUN_RADIUS = 0.006
"""Radius of the sun's disc as seen [rad]: softens shadows where they are sampled finely."""


def _pattern() -> NDArray[np.float32]:
    """Eight rooks over the pixel (x, y), and as many over the sun (across, up)."""
    order = np.array([3, 6, 1, 4, 7, 2, 5, 0])
    place = (np.arange(8) + 0.5) / 8
    sun = np.array(
        [[1, 0.2], [-0.6, 0.8], [0.1, -0.9], [-1, -0.1], [0.5, 0.9], [-0.4, -0.6], [0.8, -0.5], [-0.2, 0.3]]
    )
    return np.column_stack([place, place[order], sun * SUN_RADIUS]).astype(np.float32)


PATTERN = _pattern()


@dataclass(frozen=True)
class Picture:
    """What a camera sees."""

    pixels: NDArray[np.uint8]
    """[H, W, 3] sRGB."""
    share: NDArray[np.uint8]
    """[H, W] how much of the pixel the last body covers, of 255."""


def render(stage: Stage, camera: Camera, only: int = -1, executor: Executor | None = None) -> Picture:
    """The stage at the camera's time; ``only`` names the one body to draw (on grey 127), lit as in the street."""
    height, width = camera.height, camera.width
    colors = wp.empty((height, width), dtype=wp.vec3, device="cpu")
    bodies = wp.empty((height, width), dtype=int, device="cpu")
    pixels = np.empty((height, width, 3), np.uint8)
    share = np.empty((height, width), np.uint8)
    inputs = (stage.world, stage.poses(camera.time), *stage.contacts(camera.time), _eye(camera), only)
    pattern = wp.array(PATTERN, dtype=wp.vec4, device="cpu")
    outputs = [wp.array(a, device="cpu", copy=False) for a in (pixels, share)]

    def draw(first: int, count: int) -> None:
        wp.launch(
            raycast.draw, (count, width), [*inputs, first, colors, bodies], device="cpu", record_tape=False
        )

    def refine(first: int, count: int) -> None:
        arguments = [*inputs, first, pattern, colors, bodies, *outputs]
        wp.launch(raycast.refine, (count, width), arguments, device="cpu", record_tape=False)

    in_chunks(draw, height, ROWS, executor)
    in_chunks(refine, height, ROWS, executor)
    return Picture(pixels, share)


def render_depth(
    stage: Stage, camera: Camera, only: int = -1, executor: Executor | None = None
) -> NDArray[np.float32]:
    """z-depth [H, W] [m] at the pixel centres, infinite in the sky."""
    depth = np.empty((camera.height, camera.width), np.float32)
    inputs = (stage.world, stage.poses(camera.time), _eye(camera), only)
    output = wp.array(depth, device="cpu", copy=False)

    def run(first: int, count: int) -> None:
        arguments = [*inputs, first, output]
        wp.launch(raycast.measure_depth, (count, camera.width), arguments, device="cpu", record_tape=False)

    in_chunks(run, camera.height, ROWS, executor)
    return depth


def _eye(camera: Camera) -> Eye:
    eye = Eye()
    eye.pose = wp.transform(*transforms(camera.world_from_camera[None]).numpy()[0])
    eye.fx, eye.fy = float(camera.K[0, 0]), float(camera.K[1, 1])
    eye.cx, eye.cy = float(camera.K[0, 2]), float(camera.K[1, 2])
    eye.column, eye.row = 0, 0
    return eye
