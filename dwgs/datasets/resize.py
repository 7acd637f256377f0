"""Any scene at the size a fit or a network works at."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from dwgs.scene.camera import Camera
from dwgs.scene.errors import InputError
from dwgs.scene.scene import Frame, Scene

Window = tuple[float, float, float, float]


def resize_scene(scene: Scene, width: int, height: int) -> Scene:
    """The scene seen by cameras of ``width`` x ``height`` pixels.

    Images are cropped to the new aspect (columns from both sides alike, rows from the top: the sky goes) and
    resampled; K follows exactly. Nothing is read before it is asked for, and then kept in memory: a fit
    looks at every frame many times. A reactive mask stays true wherever it covered any part of a new pixel.
    """
    if width < 1 or height < 1:
        raise InputError(f"an image has at least one pixel, asked for {width}x{height}")
    return replace(
        scene,
        frames={
            name: tuple(_resize_frame(frame, width, height) for frame in frames)
            for name, frames in scene.frames.items()
        },
    )


def _resize_frame(frame: Frame, width: int, height: int) -> Frame:
    camera = frame.camera
    if (camera.width, camera.height) == (width, height):
        return frame
    window = _window(camera, width / height)
    left, top, right, bottom = window
    K = camera.K.copy()
    K[:2, 2] -= (left, top)
    K = np.diag([width / (right - left), height / (bottom - top), 1]) @ K
    size = (width, height)

    def pixels() -> NDArray[np.uint8]:
        image = Image.fromarray(frame.pixels)
        return np.array(image.resize(size, Image.Resampling.LANCZOS, window))

    def reactive_mask() -> NDArray[np.bool_]:
        mask = Image.fromarray(np.asarray(frame.reactive_mask, np.float32))
        return np.array(mask.resize(size, Image.Resampling.BOX, window)) > 0

    return replace(
        frame,
        camera=replace(camera, K=K, width=width, height=height),
        load_pixels=_remembered(pixels),
        load_reactive_mask=_remembered(reactive_mask) if frame.load_reactive_mask else None,
    )


def _window(camera: Camera, aspect: float) -> Window:
    """Left, top, right, bottom [px] of the largest part of the image with that aspect."""
    width = min(camera.width, camera.height * aspect)
    height = min(camera.height, camera.width / aspect)
    left = (camera.width - width) / 2
    return left, camera.height - height, left + width, camera.height


def _remembered(load: Callable[[], NDArray]) -> Callable[[], NDArray]:
    """``load`` done once; each caller gets a copy to write in."""
    once = cache(load)
    return lambda: once().copy()
