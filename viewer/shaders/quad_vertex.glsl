// One quad per splat, along the axes of its ellipse, in the given order.
layout(std430, binding = 5) readonly buffer Splats { Splat splats[]; };
layout(std430, binding = 7) readonly buffer Order { uint order[]; };

uniform vec2 image_size;

flat out vec4 mean_depth_opacity;
flat out vec3 conic;
flat out vec3 color;

void main() {
    Splat splat = splats[order[gl_InstanceID]];
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    vec2 across = normalize(vec2(-splat.major.y, splat.major.x)) * splat.minor;
    vec2 pixel = splat.mean + corner.x * splat.major + corner.y * across;
    // Image rows grow downwards and GL rows upwards: kept alike, so that row 0 is read back first.
    gl_Position = vec4(2.0 * pixel / image_size - 1.0, 0.0, 1.0);
    mean_depth_opacity = vec4(splat.mean, splat.depth, splat.opacity);
    conic = splat.conic;
    color = splat.color;
}
