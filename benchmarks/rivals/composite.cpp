// The two compositing loops as plain C++ with compiler vector types: what this CPU can do at best.
//
// A register holds a block of 4x4 pixels, or one number of sixteen Gaussians: that takes AVX-512, without which
// the result is the same but no limit of anything. Names are those of dwgs/splat/kernels, where canvas.py has the
// maths; `Projected.records` has the fields of a record. The three constants in capitals come from constants.py.

#include <cstring>
#ifdef __AVX512DQ__
#include <immintrin.h>
#endif

typedef float block __attribute__((vector_size(64), aligned(64)));
typedef int mask __attribute__((vector_size(64), aligned(64)));

struct Job {
    const float* records;  // [N, 16]
    const int *ranges, *isect_from_sorted, *gaussian_from_isect, *ends;
    int width, height, gaussians;

    int across() const { return (width + 15) / 16; }
    int tiles() const { return across() * ((height + 15) / 16); }
};

struct Count {
    long long lanes, live;  // evaluated; of these, drawn
};

namespace {

const float max_alpha = MAX_ALPHA, stop = STOP_TRANSMITTANCE, cut = LOG_MIN_ALPHA / 8;
const float slack = 0.01f;  // [px] no rounding hides a block that an ellipse touches
const block zero = {}, one = zero + 1.0f;
const mask lane = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

// Centres of the pixels of each block, from that of the tile's first pixel [px].
const struct Pixels {
    block x[16], y[16];
    Pixels() {
        for (int b = 0; b < 16; ++b) {
            x[b] = __builtin_convertvector(lane % 4 + b % 4 * 4, block);
            y[b] = __builtin_convertvector(lane / 4 + b / 4 * 4, block);
        }
    }
} pixels;

#ifdef __AVX512DQ__
inline unsigned bits(mask m) { return _mm512_movepi32_mask((__m512i)m); }
inline block root(block x) { return (block)_mm512_maskz_sqrt_ps(0xffff, (__m512)x); }
#else
inline unsigned bits(mask m) {
    unsigned set = 0;
    for (int i = 0; i < 16; ++i) set |= (m[i] < 0) << i;
    return set;
}
inline block root(block x) {
    for (int i = 0; i < 16; ++i) x[i] = __builtin_sqrtf(x[i]);
    return x;
}
#endif
inline block lower(block a, block b) { return a < b ? a : b; }
inline block higher(block a, block b) { return a > b ? a : b; }
inline block only(mask m, block a) { return m ? a : zero; }

inline block first_halves(block a, block b) {  // a0 b0 a1 b1 ... a7 b7
    return __builtin_shufflevector(a, b, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
}
inline block last_halves(block a, block b) {  // a8 b8 ... a15 b15
    return __builtin_shufflevector(a, b, 8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
}
inline void transpose(block rows[16]) {
    for (int round = 0; round < 4; ++round) {
        block next[16];
        for (int i = 0; i < 8; ++i) {
            next[2 * i] = first_halves(rows[i], rows[i + 8]);
            next[2 * i + 1] = last_halves(rows[i], rows[i + 8]);
        }
        std::memcpy(rows, next, sizeof next);
    }
}
inline block fold(block a, block b) { return first_halves(a, b) + last_halves(a, b); }
inline block sums(const block v[10]) {  // lane i: the sum over v[i]
    const block even = fold(fold(fold(v[0], v[5]), fold(v[3], v[8])), fold(fold(v[2], v[7]), zero));
    const block odd = fold(fold(fold(v[1], v[6]), fold(v[4], v[9])), zero);
    const block all = fold(even, odd);
    return __builtin_shufflevector(all, all, 0, 1, 2, 4, 5, 8, 9, 10, 12, 13, 3, 3, 3, 3, 3, 3);
}
inline block first_two_swapped(block v) {
    return __builtin_shufflevector(v, v, 1, 0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
}

// exp(8 u) for u in [-0.7, 0], all that the cut lets pass; elsewhere the result is any number.
inline block exp8(block u) {
    block e = u * 0.005846760179652792f + 0.03977256183882582f;
    e = e * u + 0.165973975498052f;
    e = e * u + 0.4998825873621815f;
    e = e * u + 0.9999925393133835f;
    e = e * u + 0.9999999205129144f;
    e *= e;
    e *= e;
    return e * e;
}

struct Tile {
    const Job& job;
    int x, y, stride, plane, begin, end;

    Tile(const Job& job, int tile)
        : job(job), x(tile % job.across() * 16), y(tile / job.across() * 16), stride(job.across() * 16),
          plane(job.tiles() * 256), begin(job.ranges[2 * tile]), end(job.ranges[2 * tile + 1]) {}

    block inside(int b) const {  // 1 in the image: pixels beyond it start without light
        return only((pixels.x[b] < (float)(job.width - x)) & (pixels.y[b] < (float)(job.height - y)), one);
    }
    long place(int channel, int b) const {
        return (long)channel * plane + (y + b / 4 * 4) * stride + x + b % 4 * 4;
    }
    block load(const float* image, int channel, int b) const {
        block value;
        for (int row = 0; row < 4; ++row)
            std::memcpy((char*)&value + 16 * row, image + place(channel, b) + row * stride, 16);
        return value;
    }
    void store(float* image, int channel, int b, block value) const {
        for (int row = 0; row < 4; ++row)
            std::memcpy(image + place(channel, b) + row * stride, (const char*)&value + 16 * row, 16);
    }
    const float* record(int k) const {
        return job.records + 16l * job.gaussian_from_isect[job.isect_from_sorted[k]];
    }
};

// Sixteen Gaussians side by side, and which blocks their ellipses alpha = 1/255 touch.
struct Batch {
    int count;
    const float* records[16];
    block x, y, u_xx, u_xy, u_yy, u_0, color[4];  // of the mean, of the exponent / 8
    mask reached;                                 // by block: a bit for each Gaussian

    Batch(const Tile& tile, int first) : count(tile.end - first < 16 ? tile.end - first : 16) {
        for (int k = first + 32; k < first + 48 && k < tile.end; ++k)
            __builtin_prefetch(tile.job.gaussian_from_isect + tile.job.isect_from_sorted[k]);
        for (int k = first + 16; k < first + 32 && k < tile.end; ++k) __builtin_prefetch(tile.record(k));
        block g[16] = {};
        for (int n = 0; n < count; ++n) std::memcpy(g + n, records[n] = tile.record(first + n), sizeof(block));
        transpose(g);
        x = g[0] - (tile.x + 0.5f), y = g[1] - (tile.y + 0.5f);
        u_xx = g[2] * -0.0625f, u_xy = g[3] * -0.125f, u_yy = g[4] * -0.0625f, u_0 = g[12] * 0.125f;
        for (int c = 0; c < 4; ++c) color[c] = g[6 + c];

        const block extent = g[10], tilt = g[13], summit = g[14], waist = g[15], per_extent = 1.0f / extent;
        for (int strip = 0; strip < 4; ++strip) {  // of columns: from its lowest to its highest point there
            const block left = 4.0f * strip - x, right = left + 3.0f;
            const block to_top = lower(higher(summit, left), right), to_bottom = lower(higher(-summit, left), right);
            const block top_x = to_top * per_extent, bottom_x = to_bottom * per_extent;
            const block rise = waist * root(higher(1.0f - top_x * top_x, zero));
            const block fall = waist * root(higher(1.0f - bottom_x * bottom_x, zero));
            const block top = tilt * to_top + rise + (y + slack), bottom = tilt * to_bottom - fall + (y - slack);
            const unsigned across = bits((right >= -extent - slack) & (left <= extent + slack));
            for (int row = 0; row < 4; ++row)
                reached[4 * row + strip] = across & bits((bottom <= 4.0f * row + 3.0f) & (top >= 4.0f * row));
        }
        reached &= (1 << count) - 1;
    }
    unsigned blocks(int n) const { return bits(reached << (31 - n)); }
};

// Sixteen pixels meet one Gaussian.
struct Meeting {
    block dx, dy, raw, alpha;
    mask kept;

    Meeting(const Batch& g, int n, int b, block light) : dx(pixels.x[b] - g.x[n]), dy(pixels.y[b] - g.y[n]) {
        block u = dx * (dx * g.u_xx[n] + dy * g.u_xy[n]) + (dy * (dy * g.u_yy[n]) + g.u_0[n]);
        u = lower(u, zero + g.u_0[n]);  // rounding must not lift a needle above its opacity
        raw = exp8(u);
        alpha = lower(raw, zero + max_alpha);
        kept = (u >= cut) & (light >= stop);
    }
};

template <bool counting>
void draw(const Tile& tile, float* image, Count* count) {
    block T[16], C[16][4] = {};
    unsigned alive = 0;  // blocks where a pixel takes light
    for (int b = 0; b < 16; ++b) {
        T[b] = tile.inside(b);
        alive |= (bits(T[b] >= stop) != 0) << b;
    }
    for (int first = tile.begin; first < tile.end && alive; first += 16) {
        const Batch g(tile, first);
        for (unsigned blocks = alive; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            block light = T[b], color[4] = {C[b][0], C[b][1], C[b][2], C[b][3]};
            for (unsigned gaussians = g.reached[b]; gaussians; gaussians &= gaussians - 1) {
                const int n = __builtin_ctz(gaussians);
                const Meeting at(g, n, b, light);
                const block w = only(at.kept, light * at.alpha);
                for (int c = 0; c < 4; ++c) color[c] += w * g.color[c][n];
                light -= w;
                if (counting) count->lanes += 16, count->live += __builtin_popcount(bits(at.kept));
            }
            T[b] = light;
            std::memcpy(C[b], color, sizeof color);
            if (!bits(light >= stop)) alive &= ~(1u << b);
        }
    }
    for (int b = 0; b < 16; ++b) {
        for (int c = 0; c < 4; ++c) tile.store(image, c, b, C[b][c]);
        tile.store(image, 4, b, 1.0f - T[b]);
    }
}

void draw_adjoint(const Tile& tile, const float* image, const float* v_image, float* slots) {
    const auto slot = [&](int k) { return slots + 10l * tile.job.isect_from_sorted[k]; };
    block T[16], v[16][5], rest[16] = {};  // rest: what the light still to come brings to the loss
    for (int b = 0; b < 16; ++b) {
        T[b] = tile.inside(b);
        for (int c = 0; c < 5; ++c) rest[b] += (v[b][c] = tile.load(v_image, c, b)) * tile.load(image, c, b);
    }
    int first = tile.begin;
    for (; first < tile.end; first += 16) {
        unsigned alive = 0;
        for (int b = 0; b < 16; ++b) alive |= (bits(T[b] >= stop) != 0) << b;
        if (!alive) break;
        const Batch g(tile, first);
        for (int n = 0; n < g.count; ++n) {  // the lines a slot lies in
            __builtin_prefetch(slot(first + n), 1);
            __builtin_prefetch(slot(first + n) + 9, 1);
        }
        for (int n = 0; n < g.count; ++n) {
            unsigned blocks = alive & g.blocks(n);
            if (!blocks) {
                std::memset(slot(first + n), 0, 40);
                continue;
            }
            const float* record = g.records[n];
            block s[10] = {};  // of x, y, xx, xy, yy, 1, r, g, b, depth
            for (; blocks; blocks &= blocks - 1) {
                const int b = __builtin_ctz(blocks);
                const Meeting at(g, n, b, T[b]);
                const block w = only(at.kept, T[b] * at.alpha);
                block q = v[b][4];
                for (int c = 0; c < 4; ++c) q += v[b][c] * record[6 + c];
                rest[b] -= w * q;
                T[b] -= w;
                const block slope = w * q - rest[b] * (at.alpha / (1.0f - at.alpha));
                const block v_power = only(at.kept & (at.raw < max_alpha), slope);  // the clamp passes no gradient
                const block by_x = v_power * at.dx, by_y = v_power * at.dy;
                s[0] += by_x;
                s[1] += by_y;
                s[2] += by_x * at.dx;
                s[3] += by_x * at.dy;
                s[4] += by_y * at.dy;
                s[5] += v_power;
                for (int c = 0; c < 4; ++c) s[6 + c] += w * v[b][c];
            }
            const block m = sums(s);
            const block own = {record[2], record[4], -0.5f, -1.0f, -0.5f, 1.0f / record[5], 1, 1, 1, 1};
            const block other = {record[3], record[3]};
            const block value = own * m + other * first_two_swapped(m);
            std::memcpy(slot(first + n), &value, 40);
        }
    }
    for (int k = first; k < tile.end; ++k) std::memset(slot(k), 0, 40);  // behind the last light
}

}  // namespace

extern "C" {

bool is_limit() {
#ifdef __AVX512DQ__
    return true;
#else
    return false;
#endif
}
void composite(const Job* job, float* image) {
    for (int tile = 0; tile < job->tiles(); ++tile) draw<false>(Tile(*job, tile), image, nullptr);
}
void count(const Job* job, float* image, Count* count) {
    for (int tile = 0; tile < job->tiles(); ++tile) draw<true>(Tile(*job, tile), image, count);
}
void composite_adjoint(const Job* job, const float* image, const float* v_image, float* slots) {
    for (int tile = 0; tile < job->tiles(); ++tile) draw_adjoint(Tile(*job, tile), image, v_image, slots);
}
void gather(const Job* job, const float* slots, float* v_records) {
    for (int gaussian = 0, k = 0; gaussian < job->gaussians; ++gaussian) {
        float total[16] = {};
        for (; k < job->ends[gaussian]; ++k)
            for (int j = 0; j < 10; ++j) total[j] += slots[10l * k + j];
        std::memcpy(v_records + 16l * gaussian, total, sizeof total);
    }
}
}
