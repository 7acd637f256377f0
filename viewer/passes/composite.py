"""Second pass: splats onto the image, farthest first."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from viewer.shaders import set_uniforms, source


class Compositing:
    """Draws splats with premultiplied "over" blending in float32: colour and alpha, depth times alpha."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = context.program(
            vertex_shader=source("splat", "quad_vertex"), fragment_shader=source("rules", "quad_fragment")
        )
        self._quads = context.vertex_array(self._program, [])
        self._order = context.buffer(reserve=4)

    def run(self, splats: moderngl.Buffer, order: NDArray[np.uint32], target: moderngl.Framebuffer) -> None:
        """Clear ``target`` (colour, depth) and draw the ``splats`` that ``order`` [M] names into it."""
        target.use()
        target.clear()
        if not len(order):
            return
        self._order.orphan(order.nbytes)
        self._order.write(order)
        splats.bind_to_storage_buffer(5)
        self._order.bind_to_storage_buffer(7)
        set_uniforms(self._program, image_size=target.size)
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        self._quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=len(order))
