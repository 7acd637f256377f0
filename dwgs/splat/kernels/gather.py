# type: ignore  (Warp's language, which is not Python's)
"""Gradients of intersections to gradients of Gaussians, without atomics: deterministic, safe in threads.

A slot holds the gradient of the first ten fields of a record; another of F numbers that of its features.
"""

import warp as wp

from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

slot10 = wp.types.vector(length=10, dtype=float)
"""Gradient of the first ten fields of a record."""
GATHERERS = 16
"""Threads that gather the gradient of a Gaussian on a GPU, a number each: what lies side by side they read at once."""


@wp.func
def sum_slots(
    gaussian: int,
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
    ends: wp.array(dtype=int),
    per_view: int,
    trainable: int,
    features: int,
    # outputs
    v_records: wp.array(dtype=record16),
    v_features: wp.array2d(dtype=float),
):
    """Sum the slots of a Gaussian; in each view only the first are trainable."""
    index = gaussian % per_view
    if index < trainable:
        begin = int(0)  # noqa: RUF046, UP018  (a variable, not a constant)
        if gaussian > 0:
            begin = ends[gaussian - 1]
        end = ends[gaussian]
        row = gaussian / per_view * trainable + index
        total = slot10()
        for k in range(begin, end):
            total += slots[k]
        v_records[row] = record16(
            total[0], total[1], total[2], total[3], total[4], total[5],
            total[6], total[7], total[8], total[9], 0.0, 0.0,
            0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        for j in range(features):
            v_feature = float(0.0)  # noqa: UP018
            for k in range(begin, end):
                v_feature += feature_slots[k * features + j]
            v_features[row, j] = v_feature


@wp.func_native(f"""
    const int gaussian = thread / {GATHERERS}, own = thread % {GATHERERS}, index = gaussian % per_view;
    if (index >= trainable) return;
    const long long row = gaussian / per_view * (long long)trainable + index;
    const float* const record = (const float*)&records.data[gaussian];
    float* const v_record = (float*)&v_records.data[row];
    const long long room = slots.shape[0] / parts, begin = gaussian ? ends.data[gaussian - 1] : 0;
    const long long end = ends.data[gaussian] < room ? ends.data[gaussian] : room;  // there was no place for more
    auto sum_of = [&](int j) -> float {{
        float sum = 0.0f;
        for (long long k = begin * parts; k < end * parts; ++k) sum += slots.data[k][j];
        return sum;
    }};
    auto gradient_of = [&](int j, const float* sums, float sum) -> float {{
        if (j == 0) return record[2] * sums[1] + record[3] * sums[2];
        if (j == 1) return record[3] * sums[1] + record[4] * sums[2];
        if (j == 5) return sums[0] != 0.0f ? sums[0] / record[5] : 0.0f;
        return j == 2 ? -0.5f * sums[3] : j == 3 ? -sums[4] : j == 4 ? -0.5f * sums[5] : sum;
    }};
    float sums[6];
    #if defined(__CUDA_ARCH__)
    const int together = {GATHERERS};
    const float sum = own < 10 ? sum_of(own) : 0.0f;
    const unsigned group = 0xffffu << (threadIdx.x & 16);
    for (int j = 0; j < 6; ++j) sums[j] = __shfl_sync(group, sum, j, {GATHERERS});
    v_record[own] = gradient_of(own, sums, sum);
    #else
    const int together = 1;
    if (own > 0) return;
    for (int j = 0; j < 6; ++j) sums[j] = sum_of(j);
    for (int j = 0; j < {GATHERERS}; ++j) v_record[j] = gradient_of(j, sums, j < 6 || j > 9 ? 0.0f : sum_of(j));
    #endif
    for (int f = own; f < features; f += together) {{
        float sum = 0.0f;
        for (long long k = begin * feature_parts; k < end * feature_parts; ++k)
            sum += feature_slots.data[k * features + f];
        v_features.data[row * features + f] = sum;
    }}
""")
def gather_one(
    thread: int,
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
    ends: wp.array(dtype=int),
    parts: int,
    feature_parts: int,
    per_view: int,
    trainable: int,
    features: int,
    records: wp.array(dtype=record16),
    v_records: wp.array(dtype=record16),
    v_features: wp.array2d(dtype=float),
):
    """One number of a Gaussian's gradient, on a CPU all of them."""


@wp.kernel
def gather(
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
    ends: wp.array(dtype=int),
    parts: int,
    feature_parts: int,
    per_view: int,
    trainable: int,
    features: int,
    records: wp.array(dtype=record16),
    # outputs
    v_records: wp.array(dtype=record16),
    v_features: wp.array2d(dtype=float),
):
    """Gradient of every Gaussian from slots of moments, so many ``parts`` per intersection.

    Of d, the way from the mean to a pixel, and of v, the gradient by the logarithm of alpha there, these hold the sums
    of v, v d, v d d^T; then of the gradients by colour and depth. `GATHERERS` threads a Gaussian.
    """
    gather_one(
        wp.tid(),
        slots,
        feature_slots,
        ends,
        parts,
        feature_parts,
        per_view,
        trainable,
        features,
        records,
        v_records,
        v_features,
    )
