# type: ignore  (Warp's language, which is not Python's)
"""Where Gaussians are drawn: what both compositing schemes share.

    w_i = T_i alpha_i,   T_{i+1} = T_i - w_i,   image = front + sum_i w_i c_i + T_end back

Images are [V, 5 + F, H', W'] planes of whole tiles: r, g, b, depth, alpha, features; alpha is composited like a
colour of 1. Tiles are numbered view by view; so are the Gaussians, of which every view has as many.

The adjoint walks front to back as well. With q_i = v . c_i, what the pixel gains from Gaussian i, and R_i =
v . (image behind i), known in full at the start and spent Gaussian by Gaussian,

    d loss / d alpha_i = T_i q_i - R_i / (1 - alpha_i)
"""

import warp as wp


@wp.struct
class Canvas:
    """Size of one image [px], tiles across and down it; Gaussians per view.

    What lies in front (fifth plane: transmittance) and behind, [V, 5, H', W'] each, where there is such. ``feature``
    is [Gaussians, features].
    """

    width: int
    height: int
    tiles_across: int
    tiles_down: int
    gaussians: int
    has_front: int
    front: wp.array(dtype=float)
    has_back: int
    back: wp.array(dtype=float)
    features: int
    feature: wp.array(dtype=float)


@wp.struct
class Gradient:
    """Of the loss by an image, wherever it lies: [V, planes, H, W] of any strides, inside the image only."""

    rgb: wp.array4d(dtype=float)
    depth: wp.array4d(dtype=float)
    alpha: wp.array4d(dtype=float)
    features: wp.array4d(dtype=float)
