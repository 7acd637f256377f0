// Gaussians of one cloud -> splats and depth keys. EWA projection (Zwicker et al., 2001).
layout(local_size_x = 256) in;

layout(std430, binding = 0) readonly buffer Means { float means[]; };
layout(std430, binding = 1) readonly buffer Quats { vec4 quats[]; };          // components are w, x, y, z
layout(std430, binding = 2) readonly buffer Scales { float scales[]; };
layout(std430, binding = 3) readonly buffer Opacities { float opacities[]; };
layout(std430, binding = 4) readonly buffer Harmonics { float harmonics[]; };  // [N, sh_count, 3]
layout(std430, binding = 5) writeonly buffer Splats { Splat splats[]; };
layout(std430, binding = 6) writeonly buffer Keys { uint keys[]; };

uniform uint count;
uniform uint first;              // where this cloud begins in splats and keys
uniform uint sh_count;
uniform mat4 camera_from_cloud;
uniform vec3 camera_position;    // in the cloud's frame
uniform vec4 intrinsics;         // fx, fy, cx, cy
uniform vec2 image_size;

const uint CULLED = 0xFFFFFFFFu;

mat3 rotation_from_quat(vec4 wxyz) {
    vec4 q = normalize(wxyz);
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Real spherical harmonics in the order and signs of "3D Gaussian Splatting"; d has length one.
vec3 color_towards(uint i, vec3 d) {
    float x = d.x, y = d.y, z = d.z;
    float xx = x * x, yy = y * y, zz = z * z;
    float basis[16] = float[16](
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2.0 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4.0 * zz - xx - yy),
        0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570457994644658 * x * (4.0 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy));
    vec3 color = vec3(0.5);
    for (uint k = 0u; k < sh_count; ++k) {
        uint at = 3u * (i * sh_count + k);
        color += basis[k] * vec3(harmonics[at], harmonics[at + 1u], harmonics[at + 2u]);
    }
    return max(color, vec3(0.0));
}

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    keys[first + i] = CULLED;

    vec3 mean = vec3(means[3u * i], means[3u * i + 1u], means[3u * i + 2u]);
    vec3 p = (camera_from_cloud * vec4(mean, 1.0)).xyz;
    float opacity = opacities[i];
    if (!(p.z > NEAR && opacity > MIN_ALPHA)) return;

    vec2 focal = intrinsics.xy;
    vec2 center = focal * p.xy / p.z + intrinsics.zw;
    mat3 axes = mat3(camera_from_cloud) * rotation_from_quat(quats[i]);
    axes[0] *= scales[3u * i];
    axes[1] *= scales[3u * i + 1u];
    axes[2] *= scales[3u * i + 2u];
    // Rows of J W R S; the covariance is their product with their transpose.
    vec2 tangent = clamp(p.xy / p.z, -MAX_TANGENT, MAX_TANGENT);
    axes = transpose(axes);
    vec3 row_x = focal.x / p.z * (axes[0] - tangent.x * axes[2]);
    vec3 row_y = focal.y / p.z * (axes[1] - tangent.y * axes[2]);
    float xx = dot(row_x, row_x) + LOW_PASS, xy = dot(row_x, row_y), yy = dot(row_y, row_y) + LOW_PASS;

    // alpha falls to MIN_ALPHA at `reach` standard deviations; the quad ends there, a hair further for rounding.
    float reach = sqrt(2.0 * log(opacity / MIN_ALPHA)) * 1.002;
    vec2 extent = reach * sqrt(vec2(xx, yy)) + 0.02;
    if (any(lessThan(center + extent, vec2(0.0))) || any(greaterThan(center - extent, image_size))) return;

    // Determinant by Cauchy-Binet: a sum of squares, so that needles do not cancel to noise.
    vec3 minors = cross(row_x, row_y);
    float determinant = dot(minors, minors) + LOW_PASS * (xx + yy - LOW_PASS);
    float middle = 0.5 * (xx + yy), swing = length(vec2(0.5 * (xx - yy), xy));
    float angle = 0.5 * atan(2.0 * xy, xx - yy);

    Splat splat;
    splat.mean = center;
    splat.depth = p.z;
    splat.opacity = opacity;
    splat.conic = vec3(yy, -xy, xx) / determinant;
    splat.major = (reach * sqrt(middle + swing) + 0.02) * vec2(cos(angle), sin(angle));
    splat.minor = reach * sqrt(determinant / (middle + swing)) + 0.02;
    splat.color = color_towards(i, normalize(mean - camera_position));
    splats[first + i] = splat;
    keys[first + i] = floatBitsToUint(p.z);
}
