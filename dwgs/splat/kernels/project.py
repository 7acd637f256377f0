# type: ignore  (Warp's language, which is not Python's)
"""Gaussians to image records: EWA splatting (Zwicker et al. 2001) as in 3DGS, forward and adjoint.

Guards are phrased positively: NaN fails them. Names with ``v_`` are gradients of the loss by what they name.
"""

import warp as wp

from dwgs.splat import constants
from dwgs.splat.kernels.sh import sh_basis, sh_basis_adjoint, vec16

wp.set_module_options({"enable_backward": False})

LOW_PASS = wp.constant(constants.LOW_PASS)
MIN_ALPHA = wp.constant(constants.MIN_ALPHA)
NEAR = wp.constant(constants.NEAR)
MAX_TANGENT = wp.constant(constants.MAX_TANGENT)

record16 = wp.types.vector(length=16, dtype=float)
"""See `dwgs.splat.Projected.records`."""
mat23 = wp.types.matrix(shape=(2, 3), dtype=float)


@wp.struct
class Cloud:
    """The Gaussians, see `dwgs.splat.Splats`."""

    means: wp.array(dtype=wp.vec3)
    quats: wp.array(dtype=wp.vec4)
    scales: wp.array(dtype=wp.vec3)
    opacities: wp.array(dtype=float)
    sh: wp.array2d(dtype=wp.vec3)


@wp.struct
class Lens:
    """Cameras: ``intrinsics`` [V] are fx, fy, cx, cy [px], ``viewmats`` [V, K] camera_from_object.

    ``object_from_gaussian`` [N] names the object of each Gaussian; where it is empty, all belong to the first.
    """

    intrinsics: wp.array(dtype=wp.vec4)
    viewmats: wp.array2d(dtype=wp.mat44)
    object_from_gaussian: wp.array(dtype=int)
    width: float
    height: float
    antialiased: int


@wp.func
def viewmat_of(lens: Lens, view: int, gaussian: int) -> wp.mat44:
    """camera_from_object of a Gaussian's object."""
    if lens.object_from_gaussian.shape[0] > 0:
        return lens.viewmats[view, lens.object_from_gaussian[gaussian]]
    return lens.viewmats[view, 0]


@wp.func
def rotation_of(viewmat: wp.mat44) -> wp.mat33:
    """Upper left 3x3."""
    return wp.mat33(
        viewmat[0, 0], viewmat[0, 1], viewmat[0, 2],
        viewmat[1, 0], viewmat[1, 1], viewmat[1, 2],
        viewmat[2, 0], viewmat[2, 1], viewmat[2, 2],
    )  # fmt: skip


@wp.func
def translation_of(viewmat: wp.mat44) -> wp.vec3:
    """Last column."""
    return wp.vec3(viewmat[0, 3], viewmat[1, 3], viewmat[2, 3])


@wp.func
def rotation_from_quat(q: wp.vec4) -> wp.mat33:
    """Rotation of a unit wxyz quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return wp.mat33(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@wp.func
def rotation_from_quat_adjoint(q: wp.vec4, v: wp.mat33) -> wp.vec4:
    """Gradient by the unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return 2.0 * wp.vec4(
        x * (v[2, 1] - v[1, 2]) + y * (v[0, 2] - v[2, 0]) + z * (v[1, 0] - v[0, 1]),
        w * (v[2, 1] - v[1, 2]) + y * (v[0, 1] + v[1, 0]) + z * (v[0, 2] + v[2, 0]) - 2.0 * x * (v[1, 1] + v[2, 2]),
        w * (v[0, 2] - v[2, 0]) + x * (v[0, 1] + v[1, 0]) + z * (v[1, 2] + v[2, 1]) - 2.0 * y * (v[0, 0] + v[2, 2]),
        w * (v[1, 0] - v[0, 1]) + x * (v[0, 2] + v[2, 0]) + y * (v[1, 2] + v[2, 1]) - 2.0 * z * (v[0, 0] + v[1, 1]),
    )


@wp.func
def clamp_tangent(t: float) -> float:
    """Where the affine approximation of a tangent ``t`` is taken."""
    return wp.clamp(t, -MAX_TANGENT, MAX_TANGENT)


@wp.func
def jacobian(p: wp.vec3, fx: float, fy: float) -> mat23:
    """Derivative of the pixel by the camera point ``p``, tangents clamped."""
    rz = 1.0 / p[2]
    return mat23(
        fx * rz, 0.0, -fx * rz * clamp_tangent(p[0] * rz),
        0.0, fy * rz, -fy * rz * clamp_tangent(p[1] * rz),
    )  # fmt: skip


@wp.func
def covariance_of(m: mat23) -> wp.vec3:
    """(xx, xy, yy) of m m^T + low-pass [px^2]."""
    a = m[0]
    b = m[1]
    return wp.vec3(wp.dot(a, a) + LOW_PASS, wp.dot(a, b), wp.dot(b, b) + LOW_PASS)


@wp.func
def determinant_of(m: mat23) -> float:
    """det(m m^T + low-pass) by Cauchy-Binet: a sum of squares, so that needles do not cancel to noise."""
    a = m[0]
    b = m[1]
    minors = wp.cross(a, b)
    return wp.dot(minors, minors) + LOW_PASS * (wp.dot(a, a) + wp.dot(b, b)) + LOW_PASS * LOW_PASS


@wp.func
def compensation_of(m: mat23) -> float:
    """What the low-pass must leave of the opacity so that the Gaussian sheds no more light than without it.

    sqrt(det(m m^T) / det(m m^T + low-pass)): Mip-Splatting (Yu et al. 2024), its 2D filter.
    """
    minors = wp.cross(m[0], m[1])
    return wp.length(minors) / wp.sqrt(determinant_of(m))


@wp.kernel
def project(first: int, cloud: Cloud, lens: Lens, records: wp.array(dtype=record16)):
    """One record per view and Gaussian; radii stay zero where it is behind, outside, too faint or not finite."""
    index = first + wp.tid()
    view = index / cloud.means.shape[0]
    i = index % cloud.means.shape[0]
    viewmat = viewmat_of(lens, view, i)
    R = rotation_of(viewmat)
    t = translation_of(viewmat)
    intrinsics = lens.intrinsics[view]
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]

    mean = cloud.means[i]
    p = R @ mean + t
    opacity = cloud.opacities[i]
    quat = cloud.quats[i]
    squared = wp.dot(quat, quat)
    record = record16()
    scale = cloud.scales[i]
    check = mean[0] + mean[1] + mean[2] + quat[0] + quat[1] + quat[2] + quat[3]
    check += scale[0] + scale[1] + scale[2] + opacity
    is_finite = wp.isfinite(check)
    if wp.isfinite(p[2]):
        record[9] = p[2]
    if p[2] > NEAR and opacity > MIN_ALPHA and squared > 0.0:
        # in float64: where a centre lies to a millionth of a pixel decides how good the gradients are
        q = wp.mat33d(R) @ wp.vec3d(mean) + wp.vec3d(t)
        x = float(wp.float64(fx) * q[0] / q[2] + wp.float64(cx))
        y = float(wp.float64(fy) * q[1] / q[2] + wp.float64(cy))
        m = jacobian(p, fx, fy) @ R @ rotation_from_quat(quat / wp.sqrt(squared)) @ wp.diag(scale)
        covariance = covariance_of(m)
        if lens.antialiased != 0:
            opacity *= compensation_of(m)
        reach = 2.0 * wp.log(opacity / MIN_ALPHA)
        extent_x = wp.sqrt(reach * covariance[0])
        extent_y = wp.sqrt(reach * covariance[2])
        inside = reach > 0.0 and x + extent_x > 0.0 and x - extent_x < lens.width
        inside = inside and y + extent_y > 0.0 and y - extent_y < lens.height
        if inside:
            count = cloud.sh.shape[1]
            direction = wp.vec3()
            if count > 1:
                direction = wp.normalize(mean + wp.transpose(R) @ t)
            basis = sh_basis(direction, count)
            color = wp.vec3(0.5, 0.5, 0.5)
            for k in range(count):
                color += basis[k] * cloud.sh[i, k]
            determinant = determinant_of(m)
            conic = wp.vec3(covariance[2], -covariance[1], covariance[0]) / determinant
            tilt = covariance[1] / covariance[0]
            summit = covariance[1] / covariance[2] * extent_y
            waist = wp.sqrt(reach * determinant / covariance[0])
            total = x + y + extent_x + extent_y + conic[0] + conic[1] + conic[2] + color[0] + color[1] + color[2]
            is_finite = is_finite and wp.isfinite(total + tilt + summit + waist)
            if is_finite:
                record = record16(
                    x, y, conic[0], conic[1], conic[2], opacity,
                    wp.max(color[0], 0.0), wp.max(color[1], 0.0), wp.max(color[2], 0.0),
                    p[2], extent_x, extent_y, wp.log(opacity), tilt, summit, waist,
                )  # fmt: skip
    if not is_finite:
        record[12] = 1.0
    records[index] = record


@wp.func
def view_adjoint(
    cloud: Cloud,
    lens: Lens,
    records: wp.array(dtype=record16),
    v_records: wp.array(dtype=record16),
    view: int,
    span: wp.vec2i,
    v_cloud: Cloud,
) -> wp.mat44:
    """Add what one view says to the gradients of a span of Gaussians; the gradient of their pose."""
    viewmat = viewmat_of(lens, view, span[0])
    R = rotation_of(viewmat)
    Rt = wp.transpose(R)
    t = translation_of(viewmat)
    fx = lens.intrinsics[view][0]
    fy = lens.intrinsics[view][1]
    count = cloud.sh.shape[1]
    before = view * cloud.means.shape[0]
    v_R = wp.mat33()
    v_t = wp.vec3()
    v_position = wp.vec3()
    for i in range(span[0], span[1]):
        record = records[before + i]
        if record[10] > 0.0:
            v = v_records[before + i]
            mean = cloud.means[i]
            p = R @ mean + t
            rz = 1.0 / p[2]

            # colour
            v_color = wp.vec3(v[6], v[7], v[8])
            for channel in range(3):
                if record[6 + channel] <= 0.0:
                    v_color[channel] = 0.0
            direction = wp.vec3()
            distance = float(1.0)  # noqa: UP018  (a variable, not a constant)
            if count > 1:
                ray = mean + Rt @ t
                distance = wp.length(ray)
                direction = ray / distance
            basis = sh_basis(direction, count)
            v_basis = vec16()
            for k in range(count):
                v_cloud.sh[i, k] = v_cloud.sh[i, k] + basis[k] * v_color
                v_basis[k] = wp.dot(cloud.sh[i, k], v_color)
            v_direction = sh_basis_adjoint(direction, v_basis, count)
            v_ray = (v_direction - direction * wp.dot(direction, v_direction)) / distance
            v_position -= v_ray

            # conic -> covariance -> m
            quat = cloud.quats[i]
            norm = wp.length(quat)
            unit = quat / norm
            Rq = rotation_from_quat(unit)
            scale = cloud.scales[i]
            J = jacobian(p, fx, fy)
            JR = J @ R
            P = JR @ Rq
            Q = wp.mat22(record[2], record[3], record[3], record[4])
            v_Q = wp.mat22(v[2], 0.5 * v[3], 0.5 * v[3], v[4])
            v_covariance = -1.0 * (Q @ v_Q @ Q)
            v_opacity = v[5]
            if lens.antialiased != 0:
                # d sqrt(det0 / det) = (adj(S0) / sqrt(det0 det) - compensation Q) / 2 dS
                m = P @ wp.diag(scale)
                minors = wp.cross(m[0], m[1])
                det0 = wp.dot(minors, minors)
                det = determinant_of(m)
                compensation = wp.sqrt(det0 / det)
                v_compensation = 0.5 * v_opacity * cloud.opacities[i]
                adj0 = wp.mat22(wp.dot(m[1], m[1]), -wp.dot(m[0], m[1]), -wp.dot(m[0], m[1]), wp.dot(m[0], m[0]))
                v_covariance += v_compensation * (adj0 / wp.sqrt(det0 * det) - compensation * Q)
                v_opacity *= compensation
            v_P = 2.0 * (v_covariance @ P @ wp.diag(wp.cw_mul(scale, scale)))
            v_m = 2.0 * (v_covariance @ P @ wp.diag(scale))
            v_scale = wp.vec3()
            for axis in range(3):
                v_scale[axis] = v_m[0, axis] * P[0, axis] + v_m[1, axis] * P[1, axis]
            v_unit = rotation_from_quat_adjoint(unit, wp.transpose(JR) @ v_P)
            v_JR = v_P @ wp.transpose(Rq)
            v_J = v_JR @ Rt

            # centre
            u = p[0] * rz
            w = p[1] * rz
            v_u = fx * v[0]
            v_w = fy * v[1]
            if wp.abs(u) < MAX_TANGENT:
                v_u -= fx * rz * v_J[0, 2]
            if wp.abs(w) < MAX_TANGENT:
                v_w -= fy * rz * v_J[1, 2]
            v_rz = fx * (v_J[0, 0] - clamp_tangent(u) * v_J[0, 2]) + fy * (v_J[1, 1] - clamp_tangent(w) * v_J[1, 2])
            v_z = v[9] - rz * (v_u * u + v_w * w + rz * v_rz)
            v_p = wp.vec3(v_u * rz, v_w * rz, v_z)
            v_t += v_p
            v_R += wp.transpose(J) @ v_JR + wp.outer(v_p, mean)

            v_cloud.means[i] = v_cloud.means[i] + Rt @ v_p + v_ray
            v_cloud.quats[i] = v_cloud.quats[i] + (v_unit - unit * wp.dot(unit, v_unit)) / norm
            v_cloud.scales[i] = v_cloud.scales[i] + v_scale
            v_cloud.opacities[i] = v_cloud.opacities[i] + v_opacity

    # the camera stands at -R^T t
    v_t -= R @ v_position
    v_R -= wp.outer(t, v_position)
    return wp.mat44(
        v_R[0, 0], v_R[0, 1], v_R[0, 2], v_t[0],
        v_R[1, 0], v_R[1, 1], v_R[1, 2], v_t[1],
        v_R[2, 0], v_R[2, 1], v_R[2, 2], v_t[2],
        0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


@wp.kernel
def project_adjoint(
    first: int,
    cloud: Cloud,
    lens: Lens,
    records: wp.array(dtype=record16),
    v_records: wp.array(dtype=record16),
    spans: wp.array(dtype=wp.vec2i),
    # outputs
    v_cloud: Cloud,
    v_viewmats: wp.array2d(dtype=wp.mat44),
):
    """Gradients of a span of Gaussians per task, all of one object; each sums its share of the poses' gradients."""
    task = first + wp.tid()
    span = spans[task]
    count = cloud.sh.shape[1]
    for i in range(span[0], span[1]):
        v_cloud.means[i] = wp.vec3()
        v_cloud.quats[i] = wp.vec4()
        v_cloud.scales[i] = wp.vec3()
        v_cloud.opacities[i] = 0.0
        for k in range(count):
            v_cloud.sh[i, k] = wp.vec3()
    for view in range(lens.viewmats.shape[0]):
        v_viewmats[view, task] = view_adjoint(cloud, lens, records, v_records, view, span, v_cloud)
