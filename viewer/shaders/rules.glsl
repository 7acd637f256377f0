// Splat rules: the twins of dwgs/splat/constants.py; a test holds both together.
const float LOW_PASS = 0.3;            // [px^2] on the diagonal of a 2D covariance: no splat thinner than a pixel
const float MAX_ALPHA = 0.99;          // no splat hides entirely what is behind it
const float MIN_ALPHA = 1.0 / 255.0;   // less changes no 8-bit pixel
const float NEAR = 0.05;               // [m] nearer centres are not drawn
const float MAX_TANGENT = 1.3;         // the affine approximation is taken no farther out
