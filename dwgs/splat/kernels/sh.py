# type: ignore  (Warp's language, which is not Python's)
"""Real spherical harmonics to degree 3, and their gradient by direction."""

import warp as wp

from dwgs.splat.constants import SH_C0, SH_C1, SH_C2, SH_C3

wp.set_module_options({"enable_backward": False})

vec16 = wp.types.vector(length=16, dtype=float)

C0 = wp.constant(SH_C0)
C1 = wp.constant(SH_C1)
C20, C21, C22 = (wp.constant(c) for c in SH_C2)
C30, C31, C32, C33, C34 = (wp.constant(c) for c in SH_C3)


@wp.func
def sh_basis(d: wp.vec3, count: int) -> vec16:
    """The first ``count`` (1, 4, 9, 16) harmonics in unit direction ``d``; the rest stay zero."""
    x, y, z = d[0], d[1], d[2]
    basis = vec16()
    basis[0] = C0
    if count > 1:
        basis[1] = -C1 * y
        basis[2] = C1 * z
        basis[3] = -C1 * x
    if count > 4:
        basis[4] = C20 * x * y
        basis[5] = -C20 * y * z
        basis[6] = C21 * (2.0 * z * z - x * x - y * y)
        basis[7] = -C20 * x * z
        basis[8] = C22 * (x * x - y * y)
    if count > 9:
        basis[9] = -C30 * y * (3.0 * x * x - y * y)
        basis[10] = C31 * x * y * z
        basis[11] = -C32 * y * (4.0 * z * z - x * x - y * y)
        basis[12] = C33 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        basis[13] = -C32 * x * (4.0 * z * z - x * x - y * y)
        basis[14] = C34 * z * (x * x - y * y)
        basis[15] = -C30 * x * (x * x - 3.0 * y * y)
    return basis


@wp.func
def sh_basis_adjoint(d: wp.vec3, v: vec16, count: int) -> wp.vec3:
    """Gradient by the direction, from the gradients ``v`` of the first ``count`` harmonics."""
    x, y, z = d[0], d[1], d[2]
    v_d = wp.vec3()
    if count > 1:
        v_d += C1 * wp.vec3(-v[3], -v[1], v[2])
    if count > 4:
        v_d += C20 * (v[4] * wp.vec3(y, x, 0.0) - v[5] * wp.vec3(0.0, z, y) - v[7] * wp.vec3(z, 0.0, x))
        v_d += C21 * v[6] * wp.vec3(-2.0 * x, -2.0 * y, 4.0 * z) + C22 * v[8] * wp.vec3(2.0 * x, -2.0 * y, 0.0)
    if count > 9:
        s = 4.0 * z * z - x * x - y * y
        v_d -= C30 * v[9] * wp.vec3(6.0 * x * y, 3.0 * (x * x - y * y), 0.0)
        v_d += C31 * v[10] * wp.vec3(y * z, x * z, x * y)
        v_d -= C32 * v[11] * wp.vec3(-2.0 * x * y, s - 2.0 * y * y, 8.0 * y * z)
        v_d += C33 * v[12] * wp.vec3(-6.0 * x * z, -6.0 * y * z, 6.0 * z * z - 3.0 * x * x - 3.0 * y * y)
        v_d -= C32 * v[13] * wp.vec3(s - 2.0 * x * x, -2.0 * x * y, 8.0 * x * z)
        v_d += C34 * v[14] * wp.vec3(2.0 * x * z, -2.0 * y * z, x * x - y * y)
        v_d -= C30 * v[15] * wp.vec3(3.0 * (x * x - y * y), -6.0 * x * y, 0.0)
    return v_d
