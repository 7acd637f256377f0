"""Text that native snippets on a CPU begin with: a tile of 16x16 pixels, one vector register per block of 4x4."""

from math import log

from dwgs.splat.constants import MAX_ALPHA, MIN_ALPHA, STOP_TRANSMITTANCE
from dwgs.splat.kernels.lanes import TRANSPOSE

PRELUDE = f"""
    #pragma clang fp contract(on)
    typedef float block __attribute__((vector_size(64)));
    typedef float quarter __attribute__((vector_size(16)));
    typedef float loose __attribute__((vector_size(16), aligned(4)));
    typedef int mask __attribute__((vector_size(64)));
    #define blocks_of(count) ((block*)__builtin_alloca_with_align(((count) + 1) * sizeof(block), 512))
    const block zero = {{}}, one = zero + 1.0f;
    const float slack = 0.01f;  // [px] no rounding hides a block that an ellipse touches
    const block lane_x = {{0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3}};
    const block lane_y = {{0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3}};
    block pixel_x[16], pixel_y[16];  // of each block, from the tile's first
    for (int b = 0; b < 16; ++b) pixel_x[b] = lane_x + b % 4 * 4.0f, pixel_y[b] = lane_y + b / 4 * 4.0f;
    // numbers the compiler cannot see through stay in registers; known ones it would fetch anew for every block
    const float numerals[] = {{
        {MAX_ALPHA}f, {log(MIN_ALPHA) / 8!r}f, {STOP_TRANSMITTANCE}f, 0.0009785861979464097f, 0.007956781442508665f,
        0.041488791404835496f, 0.16662265143851523f, 0.4999947266087482f, 0.9999997586655688f, 0.9999999981506821f,
    }};
    const float* numeral = numerals;
    __asm__("" : "+r"(numeral) : : "memory");
    const block max_alpha = zero + numeral[0], cut = zero + numeral[1], stop = zero + numeral[2];
    const block e6 = zero + numeral[3], e5 = zero + numeral[4], e4 = zero + numeral[5], e3 = zero + numeral[6];
    const block e2 = zero + numeral[7], e1 = zero + numeral[8], e0 = zero + numeral[9];

    const int width = canvas.width, height = canvas.height;
    const bool has_front = canvas.has_front, has_back = canvas.has_back;
    const int stride = canvas.tiles_across * 16, plane = stride * canvas.tiles_down * 16;
    const int view = tile / (canvas.tiles_across * canvas.tiles_down);
    const int inside = tile - view * canvas.tiles_across * canvas.tiles_down;
    const int tile_x = inside % canvas.tiles_across * 16, tile_y = inside / canvas.tiles_across * 16;
    const float *front = canvas.front.data + view * 5ll * plane, *back = canvas.back.data + view * 5ll * plane;
    const int features = canvas.features;
    float* const shown = image.data + view * (5ll + features) * plane;
    auto feature_of = [&](int gaussian) -> const float* {{
        return canvas.feature.data + (gaussian - view * canvas.gaussians) * (long long)features;
    }};
    const int corner = tile_y * stride + tile_x;
    const int columns = width - tile_x < 16 ? width - tile_x : 16, rows = height - tile_y < 16 ? height - tile_y : 16;
    const int *isects = bins.isect_from_sorted.data, *gaussians = bins.gaussian_from_isect.data;
    const int begin = bins.ranges.data[tile][0], end = bins.ranges.data[tile][1];

    auto place = [&](int channel, int b) -> int {{ return channel * plane + corner + b / 4 * 4 * stride + b % 4 * 4; }};
    auto load = [&](const float* image, int channel, int b) -> block {{
        const float* at = image + place(channel, b);
        block value;
        for (int y = 0; y < 4; ++y) *((quarter*)&value + y) = *(const loose*)(at + y * stride);
        return value;
    }};
    auto bits = [](mask m) -> unsigned {{  // one for each lane
        typedef bool flags __attribute__((ext_vector_type(16)));
        const flags f = __builtin_convertvector(m, flags);
        unsigned short b;
        __builtin_memcpy(&b, &f, 2);
        return b;
    }};
    auto lower = [](block a, block b) -> block {{ return a < b ? a : b; }};
    auto higher = [](block a, block b) -> block {{ return a > b ? a : b; }};
    auto reciprocal = [&](block x) -> block {{
        #if defined(__AVX512F__)
        const block r = __builtin_ia32_rcp14ps512_mask(x, zero, -1);  // good to 2^-14; a step of Newton's to 2^-28
        return r * (2.0f - x * r);
        #else
        return 1.0f / x;
        #endif
    }};
{TRANSPOSE}
    // exp(8 u) for u in [-0.7, 0], all that the cut at 1/255 lets pass: the eighth power of a polynomial fitted to
    // exp there, good to 2e-9 (its Taylor series would be good to 1e-5); elsewhere the result is any number
    auto exp8 = [&](block u) -> block {{
        #pragma clang fp contract(on)
        block e = u * e6 + e5;
        e = e * u + e4;
        e = e * u + e3;
        e = e * u + e2;
        e = e * u + e1;
        e = e * u + e0;
        e *= e;
        e *= e;
        return e * e;
    }};

    block T[16];
    unsigned alive = 0;  // blocks where a pixel takes light
    for (int b = 0; b < 16; ++b) {{
        const mask inside = (pixel_x[b] < (float)columns) & (pixel_y[b] < (float)rows);
        T[b] = inside ? (has_front ? load(front, 4, b) : one) : zero;
        alive |= (bits(T[b] >= stop) != 0) << b;
    }}
"""
"""Names both loops share. Pixels outside the image start without light."""

BATCH = """
    const int count = end - first < 16 ? end - first : 16;
    for (int k = first + 16; k < first + 32 && k < end; ++k)
        __builtin_prefetch(&records.data[gaussians[isects[k]]]);  // they lie anywhere
    block g[16] = {};  // one number of all sixteen, by its place in a record
    for (int n = 0; n < count; ++n)
        __builtin_memcpy(g + n, &records.data[gaussians[isects[first + n]]], sizeof(block));
    transpose(g);
    g[0] -= tile_x + 0.5f, g[1] -= tile_y + 0.5f;
    g[2] *= -0.0625f, g[3] *= -0.125f, g[4] *= -0.0625f, g[12] *= 0.125f;  // of the exponent / 8
    const float* const numbers = (const float*)g;
    auto number = [&](int place, int n) -> float { return numbers[16 * place + n]; };
    alignas(64) int reached[16];  // by block, a bit for each Gaussian whose ellipse alpha = 1/255 touches it
    const block mean_x = g[0], mean_y = g[1], extent = g[10], tilt = g[13], summit = g[14], waist = g[15];
    const block per_extent = 1.0f / extent;
    for (int strip = 0; strip < 4; ++strip) {
        const block left = 4.0f * strip - mean_x, right = left + 3.0f;
        const block to_top = lower(higher(summit, left), right), to_bottom = lower(higher(-summit, left), right);
        const block top_x = to_top * per_extent, bottom_x = to_bottom * per_extent;
        const block rise = waist * __builtin_elementwise_sqrt(higher(1.0f - top_x * top_x, zero));
        const block fall = waist * __builtin_elementwise_sqrt(higher(1.0f - bottom_x * bottom_x, zero));
        const block top = tilt * to_top + rise + (mean_y + slack), bottom = tilt * to_bottom - fall + (mean_y - slack);
        const unsigned across = bits((right >= -extent - slack) & (left <= extent + slack));
        for (int row = 0; row < 4; ++row)
            reached[4 * row + strip] = across & bits((bottom <= 4.0f * row + 3.0f) & (top >= 4.0f * row));
    }
    *(mask*)reached &= (1 << count) - 1;
"""
"""Sixteen Gaussians at a time.

Over each of the four strips of columns an ellipse reaches from its lowest to its highest point: those of the whole
if they are in the strip, else at the strip's nearer end.
"""

MEETING = """
    const block u_0 = number(12, n) - zero;
    const block dx = pixel_x[b] - number(0, n), dy = pixel_y[b] - number(1, n);
    block u = dx * (dx * number(2, n) + dy * number(3, n)) + (dy * (dy * number(4, n)) + u_0);
    u = lower(u, u_0);  // rounding must not lift a needle above its opacity
    const block raw = exp8(u);
    const mask kept = (u >= cut) & (light >= stop);
    const block alpha = lower(raw, max_alpha), w = kept ? light * alpha : zero;
"""
"""Gaussian n meets the sixteen pixels of block b."""

GIVING = """
    red += w * number(6, n);
    green += w * number(7, n);
    blue += w * number(8, n);
    depth += w * number(9, n);
    light -= w;
"""
"""What the block has from it, and has left."""
