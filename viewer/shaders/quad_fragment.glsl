// What one splat adds to one pixel, premultiplied.
flat in vec4 mean_depth_opacity;
flat in vec3 conic;
flat in vec3 color;

layout(location = 0) out vec4 out_color;
layout(location = 1) out vec4 out_depth;

void main() {
    vec2 d = gl_FragCoord.xy - mean_depth_opacity.xy;
    float power = -0.5 * (conic.x * d.x * d.x + conic.z * d.y * d.y) - conic.y * d.x * d.y;
    float alpha = min(MAX_ALPHA, mean_depth_opacity.w * exp(power));
    if (alpha < MIN_ALPHA) discard;
    out_color = vec4(alpha * color, alpha);
    out_depth = vec4(alpha * mean_depth_opacity.z, 0.0, 0.0, alpha);
}
