# type: ignore  (Warp's language, which is not Python's)
"""Where Gaussians are drawn: what both compositing schemes share.

    w_i = T_i alpha_i,   T_{i+1} = T_i - w_i,   image = front + sum_i w_i c_i + T_end back

Images are [5, H', W'] planes of whole tiles: r, g, b, depth, alpha; alpha is composited like a colour of 1.

The adjoint walks front to back as well. With q_i = v . c_i, what the pixel gains from Gaussian i, and R_i =
v . (image behind i), known in full at the start and spent Gaussian by Gaussian,

    d loss / d alpha_i = T_i q_i - R_i / (1 - alpha_i)
"""

import warp as wp


@wp.struct
class Canvas:
    """Size [px], tiles across; if ``layered``, what lies in front (fifth plane: transmittance) and behind."""

    width: int
    height: int
    tiles_across: int
    layered: int
    front: wp.array(dtype=float)
    back: wp.array(dtype=float)
