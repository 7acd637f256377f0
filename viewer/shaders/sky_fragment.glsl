// The sky that a pixel looks at: bilinear between texel centres, round in azimuth. Filtered by hand, because
// texture units may blend in 8 bits.
uniform sampler2D sky;               // row 0 is straight up
uniform mat3 world_from_camera;
uniform vec4 intrinsics;             // fx, fy, cx, cy

out vec4 out_color;

const float PI = 3.14159265358979;

vec3 texel(ivec2 at, ivec2 size) {
    return texelFetch(sky, ivec2((at.x + size.x) % size.x, clamp(at.y, 0, size.y - 1)), 0).rgb;
}

void main() {
    vec3 d = world_from_camera * vec3((gl_FragCoord.xy - intrinsics.zw) / intrinsics.xy, 1.0);
    ivec2 size = textureSize(sky, 0);
    vec2 at = vec2(atan(d.y, d.x) / (2.0 * PI) + 0.5, atan(length(d.xy), d.z) / PI) * vec2(size) - 0.5;
    ivec2 low = ivec2(floor(at));
    vec2 part = at - vec2(low);
    vec3 upper = mix(texel(low, size), texel(low + ivec2(1, 0), size), part.x);
    vec3 lower = mix(texel(low + ivec2(0, 1), size), texel(low + ivec2(1, 1), size), part.x);
    out_color = vec4(mix(upper, lower, part.y), 0.0);  // alpha 0 leaves the image's alpha alone
}
