// One Gaussian as it lies in the image: written by the projection, read by the compositing.
struct Splat {
    vec2 mean;       // centre [px], y down
    float depth;     // z of the centre [m]
    float opacity;
    vec3 conic;      // inverse 2D covariance: xx, xy, yy [1/px^2]
    float minor;     // half of the quad's shorter side [px]
    vec3 color;      // sRGB, not below 0
    float unused;    // std430 pads here anyway
    vec2 major;      // half of the quad's longer side, as a vector [px]
    vec2 unused_too;
};
