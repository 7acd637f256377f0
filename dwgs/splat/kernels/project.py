# type: ignore  (Warp's language, which is not Python's)
"""Gaussians to image records: EWA splatting (Zwicker et al. 2001) as in 3DGS, forward and adjoint.

One text for both devices, see `lanes`: sixteen Gaussians at a time on a CPU, one on a GPU. Guards are phrased
positively: NaN fails them. Names with ``v_`` are gradients of the loss by what they name; the rows of a matrix lie
one after the other.
"""

from math import log

import warp as wp

from dwgs.splat.constants import LOW_PASS, MAX_TANGENT, MIN_ALPHA, NEAR
from dwgs.splat.kernels.lanes import NUMBERS
from dwgs.splat.kernels.sh import SH_BASIS, SH_BASIS_ADJOINT

wp.set_module_options({"enable_backward": False})

record16 = wp.types.vector(length=16, dtype=float)
"""See `dwgs.splat.Projected.records`."""


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


_GAUSSIANS = f"""
{NUMBERS}
    const float low_pass = {LOW_PASS}f, max_tangent = {MAX_TANGENT}f;
    const float *means = (const float*)cloud.means.data, *quats = (const float*)cloud.quats.data;
    const float *scales = (const float*)cloud.scales.data, *opacities = cloud.opacities.data;
    const float* sh = (const float*)cloud.sh.data;
    const int gaussians = cloud.means.shape[0], count = cloud.sh.shape[1];
    auto dot = [](const number* a, const number* b) -> number {{ return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }};
    auto clamp_tangent = [&](number t) -> number {{ return lower(higher(t, zero - max_tangent), zero + max_tangent); }};
    auto cross = [](const number* a, const number* b, number* c) -> void {{
        c[0] = a[1] * b[2] - a[2] * b[1];
        c[1] = a[2] * b[0] - a[0] * b[2];
        c[2] = a[0] * b[1] - a[1] * b[0];
    }};

    // a Gaussian before its camera: R, t of camera_from_object; m m^T is its covariance in the image [px^2]
    number R[9], t[3], mean[3], p[3], scale[3], unit[4], squared, rz, tangent_x, tangent_y;
    number Rq[9], JR[6], P[6], m[6], minors[3], m_xx, m_xy, m_yy, determinant;
    auto set_pose = [&](const float* viewmat) -> void {{
        for (int row = 0; row < 3; ++row) {{
            for (int k = 0; k < 3; ++k) R[3 * row + k] = zero + viewmat[4 * row + k];
            t[row] = zero + viewmat[4 * row + 3];
        }}
    }};
    auto set_place = [&](int i, int end) -> void {{
        for (int k = 0; k < 3; ++k) mean[k] = get(means, 3, k, i, end);
        for (int k = 0; k < 3; ++k) p[k] = dot(R + 3 * k, mean) + t[k];
    }};
    auto set_shape = [&](int i, int end) -> void {{
        for (int k = 0; k < 3; ++k) scale[k] = get(scales, 3, k, i, end);
        for (int k = 0; k < 4; ++k) unit[k] = get(quats, 4, k, i, end);
        squared = unit[0] * unit[0] + unit[1] * unit[1] + unit[2] * unit[2] + unit[3] * unit[3];
    }};
    auto set_footprint = [&](float fx, float fy) -> void {{
        const number norm = root(squared);
        for (int k = 0; k < 4; ++k) unit[k] /= norm;
        const number w = unit[0], x = unit[1], y = unit[2], z = unit[3];
        Rq[0] = 1.0f - 2.0f * (y * y + z * z), Rq[1] = 2.0f * (x * y - w * z), Rq[2] = 2.0f * (x * z + w * y);
        Rq[3] = 2.0f * (x * y + w * z), Rq[4] = 1.0f - 2.0f * (x * x + z * z), Rq[5] = 2.0f * (y * z - w * x);
        Rq[6] = 2.0f * (x * z - w * y), Rq[7] = 2.0f * (y * z + w * x), Rq[8] = 1.0f - 2.0f * (x * x + y * y);
        // J is the derivative of the pixel by the camera point, taken no farther out than max_tangent
        rz = 1.0f / p[2], tangent_x = clamp_tangent(p[0] * rz), tangent_y = clamp_tangent(p[1] * rz);
        for (int k = 0; k < 3; ++k) {{
            JR[k] = fx * rz * (R[k] - tangent_x * R[6 + k]);
            JR[3 + k] = fy * rz * (R[3 + k] - tangent_y * R[6 + k]);
        }}
        for (int k = 0; k < 6; ++k) {{
            P[k] = JR[k / 3 * 3] * Rq[k % 3] + JR[k / 3 * 3 + 1] * Rq[3 + k % 3] + JR[k / 3 * 3 + 2] * Rq[6 + k % 3];
            m[k] = P[k] * scale[k % 3];
        }}
        m_xx = dot(m, m), m_xy = dot(m, m + 3), m_yy = dot(m + 3, m + 3);
        // det(m m^T + low-pass) by Cauchy-Binet: a sum of squares, so that needles do not cancel to noise
        cross(m, m + 3, minors);
        determinant = dot(minors, minors) + low_pass * (m_xx + m_yy) + low_pass * low_pass;
    }};
"""
"""Names both directions share."""

_PROJECT = f"""
{_GAUSSIANS}
{SH_BASIS}
    const int groups = (gaussians + lanes - 1) / lanes, view = group / groups, i = group % groups * lanes;
    const float fx = lens.intrinsics.data[view][0], fy = lens.intrinsics.data[view][1];
    const float cx = lens.intrinsics.data[view][2], cy = lens.intrinsics.data[view][3];
    auto viewmat_of = [&](int gaussian) -> const float* {{
        const int object = lens.object_from_gaussian.shape[0] ? lens.object_from_gaussian.data[gaussian] : 0;
        return (const float*)(lens.viewmats.data + view * lens.viewmats.shape[1] + object);
    }};
    set_pose(viewmat_of(i));
    #if !defined(__CUDA_ARCH__)
    for (int l = 1; l < lanes && i + l < gaussians; ++l) {{
        const float* viewmat = viewmat_of(i + l);
        if (viewmat == viewmat_of(i + l - 1)) continue;
        for (int k = 0; k < 12; ++k)
            for (int m = l; m < lanes; ++m) (k % 4 == 3 ? t[k / 4] : R[k / 4 * 3 + k % 4])[m] = viewmat[k];
    }}
    #endif
    set_place(i, gaussians);
    set_shape(i, gaussians);
    number opacity = get(opacities, 1, 0, i, gaussians);
    number total = mean[0] + mean[1] + mean[2] + unit[0] + unit[1] + unit[2] + unit[3];
    total += scale[0] + scale[1] + scale[2] + opacity;
    const truth is_whole = finite(total);
    truth is_drawn = (p[2] > {NEAR}f) & (opacity > {MIN_ALPHA}f) & (squared > 0.0f);

    set_footprint(fx, fy);
    // in float64: where a centre lies to a millionth of a pixel decides how good the gradients are
    precise q[3];
    for (int k = 0; k < 3; ++k) {{
        q[k] = to_precise(t[k]);
        for (int j = 0; j < 3; ++j) q[k] += to_precise(R[3 * k + j]) * to_precise(mean[j]);
    }}
    q[2] = 1.0 / q[2];
    const number x = to_number((double)fx * q[0] * q[2] + (double)cx);
    const number y = to_number((double)fy * q[1] * q[2] + (double)cy);
    // what the low-pass must leave of the opacity so that the Gaussian sheds no more light than without it:
    // Mip-Splatting (Yu et al. 2024), its 2D filter
    if (lens.antialiased) opacity *= root(dot(minors, minors) / determinant);
    const number log_opacity = logarithm(opacity), reach = 2.0f * (log_opacity - {log(MIN_ALPHA)!r}f);
    const number xx = m_xx + low_pass, yy = m_yy + low_pass;
    const number extent_x = root(reach * xx), extent_y = root(reach * yy);
    is_drawn &= (reach > 0.0f) & (x + extent_x > 0.0f) & (x - extent_x < lens.width);
    is_drawn &= (y + extent_y > 0.0f) & (y - extent_y < lens.height);

    number color[3] = {{zero + 0.5f, zero + 0.5f, zero + 0.5f}};
    if (any(is_drawn)) {{
        number direction[3], basis[16];
        for (int k = 0; k < 3; ++k) direction[k] = mean[k] + R[k] * t[0] + R[3 + k] * t[1] + R[6 + k] * t[2];
        const number distance = root(dot(direction, direction));
        sh_basis(direction[0] / distance, direction[1] / distance, direction[2] / distance, basis);
        for (int k = 0; k < count; ++k)
            for (int c = 0; c < 3; ++c) color[c] += basis[k] * get(sh, 3 * count, 3 * k + c, i, gaussians);
    }}
    number record[16] = {{
        x, y, yy / determinant, -m_xy / determinant, xx / determinant, opacity,
        higher(color[0], zero), higher(color[1], zero), higher(color[2], zero),
        p[2], extent_x, extent_y, log_opacity, m_xy / xx, m_xy / yy * extent_y, root(reach * determinant / xx),
    }};
    total = color[0] + color[1] + color[2];
    for (int k = 0; k < 16; ++k) total += record[k];
    const truth is_broken = is_whole ? is_drawn & ~finite(total) : ~is_whole;
    is_drawn &= ~is_broken;
    for (int k = 0; k < 16; ++k) record[k] = only(is_drawn, record[k]);
    record[9] = only(finite(p[2]), p[2]);
    record[12] = is_broken ? zero + 1.0f : record[12];
    put_rows(records.data + view * (long long)per_view, i, gaussians, record);
"""

_ADJOINT = f"""
{_GAUSSIANS}
{SH_BASIS}
{SH_BASIS_ADJOINT}
    const int object = lens.object_from_gaussian.shape[0] ? lens.object_from_gaussian.data[begin] : 0;
    const float fx = lens.intrinsics.data[view][0], fy = lens.intrinsics.data[view][1];
    auto add = [&](void* rows, int width, int k, int i, number v) -> void {{
        put(rows, width, k, i, end, view ? get(rows, width, k, i, end) + v : v);
    }};
    number v_R[9], v_t[3], v_position[3];
    for (int k = 0; k < 9; ++k) v_R[k] = zero;
    for (int k = 0; k < 3; ++k) v_t[k] = v_position[k] = zero;
    set_pose((const float*)(lens.viewmats.data + view * lens.viewmats.shape[1] + object));
    for (int i = begin; i < end; i += lanes) {{
        number record[16], v[16];
        get_rows(records.data + view * (long long)per_view, i, end, record);
        get_rows(v_records.data + view * (long long)(v_records.shape[0] / lens.viewmats.shape[0]), i, end, v);
        truth is_drawn = record[10] > zero;
        #if !defined(__CUDA_ARCH__)
        for (int l = end - i; l < lanes; ++l) is_drawn[l] = 0;
        #endif
        set_place(i, end);
        set_shape(i, end);
        const number norm = root(squared);
        set_footprint(fx, fy);

        // colour
        number v_color[3], ray[3], direction[3], v_direction[3], basis[16], v_basis[16];
        for (int c = 0; c < 3; ++c) v_color[c] = only(is_drawn & (record[6 + c] > zero), v[6 + c]);
        for (int k = 0; k < 3; ++k) ray[k] = mean[k] + R[k] * t[0] + R[3 + k] * t[1] + R[6 + k] * t[2];
        const number distance = root(dot(ray, ray));
        for (int k = 0; k < 3; ++k) direction[k] = ray[k] / distance;
        sh_basis(direction[0], direction[1], direction[2], basis);
        for (int k = 0; k < count; ++k) {{
            v_basis[k] = zero;
            for (int c = 0; c < 3; ++c) {{
                v_basis[k] += get(sh, 3 * count, 3 * k + c, i, end) * v_color[c];
                add(v_cloud.sh.data, 3 * count, 3 * k + c, i, only(is_drawn, basis[k] * v_color[c]));
            }}
        }}
        sh_basis_adjoint(direction[0], direction[1], direction[2], v_basis, v_direction);
        number v_ray[3];
        const number along = dot(direction, v_direction);
        for (int k = 0; k < 3; ++k) {{
            v_ray[k] = only(is_drawn, (v_direction[k] - direction[k] * along) / distance);
            v_position[k] -= v_ray[k];
        }}

        // conic -> covariance -> m: v_covariance = -Q v_Q Q
        const number a = record[2], b = record[3], c = record[4], v_b = 0.5f * v[3];
        const number left[4] = {{a * v[2] + b * v_b, a * v_b + b * v[4], b * v[2] + c * v_b, b * v_b + c * v[4]}};
        number v_xx = -(left[0] * a + left[1] * b), v_xy = -(left[0] * b + left[1] * c);
        number v_yy = -(left[2] * b + left[3] * c), v_opacity = v[5];
        if (lens.antialiased) {{
            // d sqrt(det0 / det) = (adj(S0) / sqrt(det0 det) - compensation Q) / 2 dS
            const number det0 = dot(minors, minors), compensation = root(det0 / determinant);
            const number v_compensation = 0.5f * v_opacity * get(opacities, 1, 0, i, end);
            const number both = root(det0 * determinant);
            v_xx += v_compensation * (m_yy / both - compensation * a);
            v_xy += v_compensation * (-m_xy / both - compensation * b);
            v_yy += v_compensation * (m_xx / both - compensation * c);
            v_opacity *= compensation;
        }}
        number v_P[6], v_scale[3], v_Rq[9], v_JR[6];
        for (int k = 0; k < 3; ++k) {{
            const number x = 2.0f * (v_xx * P[k] + v_xy * P[3 + k]), y = 2.0f * (v_xy * P[k] + v_yy * P[3 + k]);
            v_scale[k] = scale[k] * (x * P[k] + y * P[3 + k]);
            v_P[k] = x * scale[k] * scale[k], v_P[3 + k] = y * scale[k] * scale[k];
        }}
        for (int k = 0; k < 9; ++k) v_Rq[k] = JR[k / 3] * v_P[k % 3] + JR[3 + k / 3] * v_P[3 + k % 3];
        for (int k = 0; k < 6; ++k) v_JR[k] = dot(v_P + k / 3 * 3, Rq + 3 * (k % 3));
        const number w = unit[0], x = unit[1], y = unit[2], z = unit[3];
        const number v_unit[4] = {{
            2.0f * (x * (v_Rq[7] - v_Rq[5]) + y * (v_Rq[2] - v_Rq[6]) + z * (v_Rq[3] - v_Rq[1])),
            2.0f * (w * (v_Rq[7] - v_Rq[5]) + y * (v_Rq[1] + v_Rq[3]) + z * (v_Rq[2] + v_Rq[6])
                    - 2.0f * x * (v_Rq[4] + v_Rq[8])),
            2.0f * (w * (v_Rq[2] - v_Rq[6]) + x * (v_Rq[1] + v_Rq[3]) + z * (v_Rq[5] + v_Rq[7])
                    - 2.0f * y * (v_Rq[0] + v_Rq[8])),
            2.0f * (w * (v_Rq[3] - v_Rq[1]) + x * (v_Rq[2] + v_Rq[6]) + y * (v_Rq[5] + v_Rq[7])
                    - 2.0f * z * (v_Rq[0] + v_Rq[4])),
        }};
        const number radial = w * v_unit[0] + x * v_unit[1] + y * v_unit[2] + z * v_unit[3];

        // centre: J is (fx rz, 0, -fx rz tangent_x), (0, fy rz, -fy rz tangent_y)
        const number v_J00 = dot(v_JR, R), v_J02 = dot(v_JR, R + 6), v_J11 = dot(v_JR + 3, R + 3);
        const number v_J12 = dot(v_JR + 3, R + 6), u_x = p[0] * rz, u_y = p[1] * rz;
        const truth is_x_free = (u_x < max_tangent) & (u_x > -max_tangent);
        const truth is_y_free = (u_y < max_tangent) & (u_y > -max_tangent);
        const number v_x = fx * v[0] - only(is_x_free, fx * rz * v_J02);
        const number v_y = fy * v[1] - only(is_y_free, fy * rz * v_J12);
        const number v_rz = fx * (v_J00 - tangent_x * v_J02) + fy * (v_J11 - tangent_y * v_J12);
        const number v_p[3] = {{
            only(is_drawn, v_x * rz), only(is_drawn, v_y * rz),
            only(is_drawn, v[9] - rz * (v_x * u_x + v_y * u_y + rz * v_rz)),
        }};
        const number J00 = fx * rz, J02 = -J00 * tangent_x, J11 = fy * rz, J12 = -J11 * tangent_y;
        for (int k = 0; k < 3; ++k) {{
            v_t[k] += v_p[k];
            v_R[k] += only(is_drawn, J00 * v_JR[k] + v_p[0] * mean[k]);
            v_R[3 + k] += only(is_drawn, J11 * v_JR[3 + k] + v_p[1] * mean[k]);
            v_R[6 + k] += only(is_drawn, J02 * v_JR[k] + J12 * v_JR[3 + k] + v_p[2] * mean[k]);
        }}
        for (int k = 0; k < 3; ++k) {{
            add(v_cloud.means.data, 3, k, i, R[k] * v_p[0] + R[3 + k] * v_p[1] + R[6 + k] * v_p[2] + v_ray[k]);
            add(v_cloud.scales.data, 3, k, i, only(is_drawn, v_scale[k]));
        }}
        for (int k = 0; k < 4; ++k) {{
            const number v_quat = (v_unit[k] - unit[k] * radial) / norm;
            add(v_cloud.quats.data, 4, k, i, only(is_drawn, v_quat));
        }}
        add(v_cloud.opacities.data, 1, 0, i, only(is_drawn, v_opacity));
    }}

    // the camera stands at -R^T t
    if (v_viewmats.shape[1] == 0) return;
    float* v_pose = (float*)(v_viewmats.data + view * (long long)v_viewmats.shape[1] + task);
    for (int row = 0; row < 3; ++row) {{
        v_pose[4 * row + 3] = sum(v_t[row] - dot(R + 3 * row, v_position));
        for (int k = 0; k < 3; ++k) v_pose[4 * row + k] = sum(v_R[3 * row + k] - t[row] * v_position[k]);
        v_pose[12 + row] = 0.0f;
    }}
    v_pose[15] = 0.0f;
"""


@wp.func_native(_PROJECT)
def project_group(group: int, cloud: Cloud, lens: Lens, per_view: int, records: wp.array(dtype=record16)):
    """Write the records of as many Gaussians as a number has lanes; those of a view come first among ``per_view``."""


@wp.func_native(_ADJOINT)
def project_span_adjoint(
    begin: int,
    end: int,
    view: int,
    cloud: Cloud,
    lens: Lens,
    per_view: int,
    records: wp.array(dtype=record16),
    v_records: wp.array(dtype=record16),
    v_cloud: Cloud,
    v_viewmats: wp.array2d(dtype=wp.mat44),
    task: int,
):
    """Add what one view says to the gradients of a span of Gaussians; the gradient of their pose."""


@wp.func
def project_adjoint_of(
    task: int,
    cloud: Cloud,
    lens: Lens,
    per_view: int,
    records: wp.array(dtype=record16),
    v_records: wp.array(dtype=record16),
    spans: wp.array(dtype=wp.vec2i),
    v_cloud: Cloud,
    v_viewmats: wp.array2d(dtype=wp.mat44),
):
    """Gradients of one span, over all views."""
    span = spans[task]
    for view in range(lens.viewmats.shape[0]):
        project_span_adjoint(
            span[0], span[1], view, cloud, lens, per_view, records, v_records, v_cloud, v_viewmats, task
        )


@wp.kernel
def project(first: int, cloud: Cloud, lens: Lens, per_view: int, records: wp.array(dtype=record16)):
    """One record per view and Gaussian; radii stay zero where it is behind, outside, too faint or not finite."""
    project_group(first + wp.tid(), cloud, lens, per_view, records)


@wp.kernel
def project_adjoint(
    first: int,
    cloud: Cloud,
    lens: Lens,
    per_view: int,
    records: wp.array(dtype=record16),
    v_records: wp.array(dtype=record16),
    spans: wp.array(dtype=wp.vec2i),
    # outputs
    v_cloud: Cloud,
    v_viewmats: wp.array2d(dtype=wp.mat44),
):
    """Gradients of a span of Gaussians per task, all of one object; each sums its share of the poses' gradients.

    These only where there is room for them.
    """
    project_adjoint_of(first + wp.tid(), cloud, lens, per_view, records, v_records, spans, v_cloud, v_viewmats)
