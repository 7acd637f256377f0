"""Last pass: the sky, wherever the splats let it through."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera
from viewer.shaders import intrinsics, set_uniforms, source


class Sky:
    """Adds (1 - alpha) times an equirectangular sky to the colour of an image."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = context.program(vertex_shader=source("sky_vertex"), fragment_shader=source("sky_fragment"))
        self._triangle = context.vertex_array(self._program, [])
        self._sky: NDArray[np.float32] | None = None
        self._texture: moderngl.Texture | None = None

    def run(self, sky: NDArray[np.float32], camera: Camera, target: moderngl.Framebuffer) -> None:
        """Draw ``sky`` [H, W, 3] behind the premultiplied colour in ``target``; alpha stays."""
        target.use()
        self._texture_of(sky).use(0)
        set_uniforms(
            self._program,
            world_from_camera=tuple(camera.world_from_camera[:3, :3].T.ravel()),
            intrinsics=intrinsics(camera),
        )
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE
        self._triangle.render(moderngl.TRIANGLES, vertices=3)

    def _texture_of(self, sky: NDArray[np.float32]) -> moderngl.Texture:
        if self._texture is None or self._sky is not sky:
            if self._texture is not None:
                self._texture.release()
            height, width = sky.shape[:2]
            self._sky = sky
            self._texture = self._context.texture(
                (width, height), 3, np.ascontiguousarray(sky), dtype="f4", alignment=4
            )
        return self._texture
