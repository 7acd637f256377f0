# type: ignore  (Warp's language, which is not Python's)
"""The two compositing loops on a GPU: one block per 16x16 tile, one thread per pixel.

The same source runs on a CPU, a warp being one lane there: slow, but a witness for everything but the
shuffles. Launched over tiles x `BLOCK` threads, ``block_dim=BLOCK``.
"""

import warp as wp

from dwgs.splat import constants
from dwgs.splat.kernels.bins import Bins
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

BLOCK = constants.TILE * constants.TILE
"""Threads per tile."""
LANES = 32
"""Threads per warp, on a GPU."""
SLOTS = BLOCK // LANES
"""Gradients per intersection: each warp writes its own, so no atomics, and the same bytes every time."""

TILE = wp.constant(constants.TILE)
MAX_ALPHA = wp.constant(constants.MAX_ALPHA)
MIN_ALPHA = wp.constant(constants.MIN_ALPHA)
STOP_TRANSMITTANCE = wp.constant(constants.STOP_TRANSMITTANCE)
_BLOCK = wp.constant(BLOCK)

vec5 = wp.types.vector(length=5, dtype=float)
"""r, g, b, depth, alpha."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int mask = 16; mask > 0; mask /= 2) value += __shfl_xor_sync(0xffffffffu, value, mask);
#endif
    return value;
""")
def sum_lanes(value: float) -> float:
    """Sum over the warp, in every lane."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __any_sync(0xffffffffu, value);
#else
    return value;
#endif
""")
def any_lane(value: int) -> int:
    """Whether ``value`` is not 0 in some lane of the warp."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return 32;
#else
    return 1;
#endif
""")
def lanes() -> int:
    """Threads per warp."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __syncthreads_and(value);
#else
    return value;
#endif
""")
def all_threads(value: int) -> int:
    """Whether ``value`` is not 0 in every thread of the block, which all of them must ask."""


@wp.func_native(
    f"""
    auto record_of = [&](int k) -> const record16* {{
        return records.data + bins.gaussian_from_isect.data[bins.isect_from_sorted.data[k]];
    }};
#if defined(__CUDA_ARCH__)
    __shared__ float4 batch[{BLOCK}][4];
    if (k < begin) {{
        const int own = begin + threadIdx.x;
        __syncthreads();  // nobody reads the batch before any more
        if (own < end) for (int j = 0; j < 4; ++j) batch[threadIdx.x][j] = ((const float4*)record_of(own))[j];
        __syncthreads();
        return record16();
    }}
    return *(const record16*)batch[k - begin];
#else
    return k < begin ? record16() : *record_of(k);
#endif
""".replace("record16", "wp::vec_t<16, float>")
)
def batched(records: wp.array(dtype=record16), bins: Bins, begin: int, end: int, k: int) -> record16:
    """The record of intersection ``k``, one of the next `BLOCK` from ``begin`` on.

    First, with ``k`` of -1, all threads of a block carry these into shared memory, one each.
    """


@wp.struct
class Pixel:
    """Where a thread draws."""

    tile: int
    plane: int
    index: int
    """In planes of r, g, b, depth, alpha."""
    shown: int
    """In planes that features follow."""
    before: int
    """Gaussians of earlier views."""
    view: int
    column: int
    row: int
    x: float
    y: float


@wp.func
def pixel_of(thread: int, canvas: Canvas) -> Pixel:
    """Thread by thread along the rows of each tile."""
    pixel = Pixel()
    pixel.tile = thread / _BLOCK
    inside = thread % _BLOCK
    tiles = canvas.tiles_across * canvas.tiles_down
    view = pixel.tile / tiles
    tile = pixel.tile - view * tiles
    pixel.view = view
    x = tile % canvas.tiles_across * TILE + inside % TILE
    y = tile / canvas.tiles_across * TILE + inside / TILE
    stride = canvas.tiles_across * TILE
    pixel.plane = stride * canvas.tiles_down * TILE
    pixel.index = view * 5 * pixel.plane + y * stride + x
    pixel.shown = view * (5 + canvas.features) * pixel.plane + y * stride + x
    pixel.before = view * canvas.gaussians
    pixel.column = x
    pixel.row = y
    pixel.x = float(x) + 0.5
    pixel.y = float(y) + 0.5
    return pixel


@wp.func
def light_at(pixel: Pixel, canvas: Canvas) -> float:
    """Transmittance before the first Gaussian; none outside the image."""
    light = 1.0
    if canvas.layered != 0:
        light = canvas.front[4 * pixel.plane + pixel.index]
    elif pixel.x > float(canvas.width) or pixel.y > float(canvas.height):
        light = 0.0
    return light


@wp.func
def gradient_at(v: wp.array4d(dtype=float), channel: int, pixel: Pixel) -> float:
    """Of the loss by one channel; 0 outside the image."""
    if pixel.row < v.shape[2] and pixel.column < v.shape[3]:
        return v[pixel.view, channel, pixel.row, pixel.column]
    return 0.0


@wp.func
def falloff(record: record16, dx: float, dy: float) -> float:
    """exp(-d^T conic d / 2), 0 where rounding would lift it above 1."""
    power = -0.5 * (record[2] * dx * dx + record[4] * dy * dy) - record[3] * dx * dy
    return wp.exp(wp.min(power, 0.0))


@wp.func
def colors_of(record: record16) -> vec5:
    """What a Gaussian adds per weight."""
    return vec5(record[6], record[7], record[8], record[9], 1.0)


@wp.kernel
def composite(
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    # outputs
    image: wp.array(dtype=float),
):
    """Draw one pixel per thread."""
    pixel = pixel_of(wp.tid(), canvas)
    T = light_at(pixel, canvas)
    total = vec5()
    total[4] = 1.0 - T
    if canvas.layered != 0:
        for c in range(4):
            total[c] = canvas.front[c * pixel.plane + pixel.index]
    for f in range(canvas.features):
        image[(5 + f) * pixel.plane + pixel.shown] = 0.0
    span = bins.ranges[pixel.tile]
    for begin in range(span[0], span[1], _BLOCK):
        if all_threads(int(T < STOP_TRANSMITTANCE)) != 0:
            break
        batched(records, bins, begin, span[1], -1)
        for k in range(begin, wp.min(begin + _BLOCK, span[1])):
            if T < STOP_TRANSMITTANCE:
                break
            record = batched(records, bins, begin, span[1], k)
            alpha = record[5] * falloff(record, pixel.x - record[0], pixel.y - record[1])
            if alpha >= MIN_ALPHA:
                w = T * wp.min(alpha, MAX_ALPHA)
                total += w * colors_of(record)
                T -= w
                row = (bins.gaussian_from_isect[bins.isect_from_sorted[k]] - pixel.before) * canvas.features
                for f in range(canvas.features):
                    at = (5 + f) * pixel.plane + pixel.shown
                    image[at] = image[at] + w * canvas.feature[row + f]
    for c in range(5):
        if canvas.layered != 0:
            total[c] += T * canvas.back[c * pixel.plane + pixel.index]
        image[c * pixel.plane + pixel.shown] = total[c]


@wp.kernel
def composite_adjoint(
    canvas: Canvas,
    bins: Bins,
    records: wp.array(dtype=record16),
    image: wp.array(dtype=float),
    v_image: Gradient,
    trainable: int,
    # outputs
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
):
    """One pixel per thread, one slot per warp. No lane leaves early: all of a warp take part in its sums."""
    thread = wp.tid()
    pixel = pixel_of(thread, canvas)
    T = light_at(pixel, canvas)
    v = vec5()
    rest = float(0.0)  # noqa: UP018  (a variable, not a constant)
    for c in range(3):
        v[c] = gradient_at(v_image.rgb, c, pixel)
    v[3] = gradient_at(v_image.depth, 0, pixel)
    v[4] = gradient_at(v_image.alpha, 0, pixel)
    for c in range(5):
        behind = image[c * pixel.plane + pixel.shown]
        if canvas.layered != 0:
            if c < 4:
                behind -= canvas.front[c * pixel.plane + pixel.index]
            else:
                behind -= 1.0 - T
        rest += v[c] * behind
    for f in range(canvas.features):
        at = (5 + f) * pixel.plane + pixel.shown
        rest += gradient_at(v_image.features, f, pixel) * image[at]
    warps = _BLOCK / lanes()
    warp = thread % _BLOCK / lanes()
    is_writer = thread % lanes() == 0
    span = bins.ranges[pixel.tile]
    for begin in range(span[0], span[1], _BLOCK):
        batched(records, bins, begin, span[1], -1)
        for k in range(begin, wp.min(begin + _BLOCK, span[1])):
            isect = bins.isect_from_sorted[k]
            gaussian = bins.gaussian_from_isect[isect]
            record = batched(records, bins, begin, span[1], k)
            dx = pixel.x - record[0]
            dy = pixel.y - record[1]
            raw = record[5] * falloff(record, dx, dy)
            is_kept = raw >= MIN_ALPHA and T >= STOP_TRANSMITTANCE
            slot = slot10()
            w = float(0.0)  # noqa: UP018
            if is_kept:
                alpha = wp.min(raw, MAX_ALPHA)
                w = T * alpha
                q = wp.dot(v, colors_of(record))
                for f in range(canvas.features):
                    feature = canvas.feature[(gaussian - pixel.before) * canvas.features + f]
                    q += gradient_at(v_image.features, f, pixel) * feature
                rest -= w * q
                T -= w
                if raw < MAX_ALPHA:  # the clamp passes no gradient
                    v_power = w * q - rest * alpha / (1.0 - alpha)
                    slot[0] = v_power * (record[2] * dx + record[3] * dy)
                    slot[1] = v_power * (record[3] * dx + record[4] * dy)
                    slot[2] = -0.5 * v_power * dx * dx
                    slot[3] = -v_power * dx * dy
                    slot[4] = -0.5 * v_power * dy * dy
                    slot[5] = v_power / record[5]
                for c in range(4):
                    slot[6 + c] = w * v[c]
            if gaussian - pixel.before < trainable:
                is_touched = any_lane(int(is_kept)) != 0
                at = isect * warps + warp
                for j in range(10):
                    if is_touched:
                        slot[j] = sum_lanes(slot[j])
                if is_writer:
                    slots[at] = slot
                for f in range(canvas.features):
                    v_feature = w * gradient_at(v_image.features, f, pixel)
                    if is_touched:
                        v_feature = sum_lanes(v_feature)
                    if is_writer:
                        feature_slots[at * canvas.features + f] = v_feature
