"""The render core: a scene graph and a camera to a picture, without a window."""

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dwgs.scene import Camera, InputError
from viewer.passes.composite import Compositing
from viewer.passes.project import Projection
from viewer.passes.sky import Sky
from viewer.scene_graph import SceneGraph
from viewer.sort import back_to_front

DEBIAN_PACKAGES = "libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"
"""What a machine without a screen needs to draw."""


@dataclass(frozen=True)
class Image:
    """A picture, in float32."""

    rgb: NDArray[np.float32]
    """[H, W, 3] sRGB with the sky behind; not clipped, a splat may be brighter than 1."""
    depth: NDArray[np.float32]
    """[H, W] expected z of the Gaussians [m]; 0 where there are none."""
    alpha: NDArray[np.float32]
    """[H, W] how much of the pixel Gaussians cover, in [0, 1]."""


class Renderer:
    """Draws pictures of one size, one at a time, on the thread that made it.

    The same scene graph and camera give the same bytes on the same device.
    """

    def __init__(self, width: int, height: int) -> None:
        """Open an EGL context of OpenGL 4.3; `InputError` names the packages of a machine that has none."""
        self.width, self.height = width, height
        self._context = _open_context()
        with self._context:
            self._projection = Projection(self._context)
            self._compositing = Compositing(self._context)
            self._sky = Sky(self._context)
            color = self._context.texture((width, height), 4, dtype="f4")
            depth = self._context.texture((width, height), 1, dtype="f4")
            self._layers = self._context.framebuffer([color, depth])
            self._picture = self._context.framebuffer([color])
            self.device: str = self._context.info["GL_RENDERER"]
            """What draws, in the driver's words; "llvmpipe" is a CPU."""

    def render(self, scene_graph: SceneGraph, camera: Camera, exposure: ArrayLike = (1, 1, 1)) -> Image:
        """What ``camera`` sees at its time; ``exposure`` [3] is its gain on the finished colour.

        All Gaussians of all objects are sorted together by their depth. Raises `InputError` where the size of
        the camera is not the renderer's.
        """
        if (camera.width, camera.height) != (self.width, self.height):
            raise InputError(
                f"this renderer draws {self.width}x{self.height}, the camera {camera.width}x{camera.height}; "
                f"resize the camera or make another renderer"
            )
        with self._context:
            keys = self._projection.run(scene_graph.clouds_at(camera.time), camera)
            self._compositing.run(self._projection.splats, back_to_front(keys), self._layers)
            self._sky.run(scene_graph.sky, camera, self._picture)
            color, weighted_depth = self._read(0, 4), self._read(1, 1)[..., 0]
        alpha = color[..., 3]
        return Image(
            rgb=color[..., :3] * np.asarray(exposure, np.float32),
            depth=(weighted_depth / np.maximum(alpha, 1e-10)).astype(np.float32, copy=False),
            alpha=alpha,
        )

    def close(self) -> None:
        """Give the device back; the renderer is of no use afterwards."""
        self._context.release()

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self, attachment: int, channels: int) -> NDArray[np.float32]:
        data = self._layers.read(components=channels, attachment=attachment, dtype="f4", alignment=4)
        return np.frombuffer(data, np.float32).reshape(self.height, self.width, channels)


def _open_context() -> moderngl.Context:
    try:
        # Named outright: looking libraries up needs a compiler or ldconfig, which slim systems lack.
        settings: dict[str, Any] = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}
        return moderngl.create_context(standalone=True, require=430, **settings)
    except Exception as error:  # the loader raises whatever it met
        raise InputError(
            f"drawing needs OpenGL 4.3 through EGL, and this machine says '{error}'; on Debian or Ubuntu: "
            f"apt-get install {DEBIAN_PACKAGES}"
        ) from error
