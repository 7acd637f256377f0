"""The splat rules: what a Gaussian looks like in an image. Every renderer here obeys these numbers."""

LOW_PASS = 0.3
"""Added to the diagonal of the image covariance [px^2]: no Gaussian falls between two pixels (as in 3DGS)."""

MAX_ALPHA = 0.99
"""A Gaussian lets at least 1 % of the light through: the adjoint divides by 1 - alpha."""

MIN_ALPHA = 1 / 255
"""Weaker than this is not drawn: it could not change an 8-bit pixel, and it gives every Gaussian an edge."""

STOP_TRANSMITTANCE = 1e-4
"""A pixel takes no further Gaussian once its transmittance, tested before that Gaussian, is below this.

What lies behind weighs at most 1e-4, and what is drawn is a prefix: the same in forward and adjoint.
"""

NEAR = 0.05
"""Centres nearer than this [m], or behind the camera, are not drawn: the projection is not affine there."""

MAX_TANGENT = 1.3
"""The affine approximation is taken no farther out than |x/z|, |y/z| = this.

3DGS takes 1.3 tan(fov / 2); here that of a 90 degree camera stands for every camera, so that the rule knows
no image border and a crop shows the pixels of the whole.
"""

TILE = 16
"""Tiles are 16x16 px: one AVX-512 register is one row, one CUDA block is one tile."""

SH_C0 = 0.28209479177387814
SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
SH_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)
"""Real spherical harmonics by degree, magnitudes in the order they appear; colour = max(0.5 + sum, 0)."""
