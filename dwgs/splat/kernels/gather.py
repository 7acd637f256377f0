# type: ignore  (Warp's language, which is not Python's)
"""Gradients of intersections to gradients of Gaussians, without atomics: deterministic, safe in threads.

A slot holds the gradient of the first ten fields of a record; another of F numbers that of its features.
"""

import warp as wp

from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

slot10 = wp.types.vector(length=10, dtype=float)
"""Gradient of the first ten fields of a record."""


@wp.func
def sum_slots(
    gaussian: int,
    slots: wp.array(dtype=slot10),
    feature_slots: wp.array(dtype=float),
    ends: wp.array(dtype=int),
    parts: int,
    feature_parts: int,
    per_view: int,
    trainable: int,
    features: int,
    # outputs
    v_records: wp.array(dtype=record16),
    v_features: wp.array2d(dtype=float),
):
    """Sum the slots of a Gaussian, so many ``parts`` per intersection; in each view only the first are trainable."""
    index = gaussian % per_view
    if index < trainable:
        begin = int(0)  # noqa: RUF046, UP018  (a variable, not a constant)
        if gaussian > 0:
            begin = ends[gaussian - 1]
        end = wp.min(ends[gaussian], slots.shape[0] / parts)  # there may have been no room for more
        row = gaussian / per_view * trainable + index
        total = slot10()
        for k in range(begin * parts, end * parts):
            total += slots[k]
        v_records[row] = record16(
            total[0], total[1], total[2], total[3], total[4], total[5],
            total[6], total[7], total[8], total[9], 0.0, 0.0,
            0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        for j in range(features):
            v_feature = float(0.0)  # noqa: UP018
            for k in range(begin * feature_parts, end * feature_parts):
                v_feature += feature_slots[k * features + j]
            v_features[row, j] = v_feature


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
    """Gradient of every Gaussian from slots of moments.

    Of d, the way from the mean to a pixel, and of v, the gradient by the logarithm of alpha there, these hold the sums
    of v, v d, v d d^T; then of the gradients by colour and depth.
    """
    gaussian = wp.tid()
    sum_slots(
        gaussian,
        slots,
        feature_slots,
        ends,
        parts,
        feature_parts,
        per_view,
        trainable,
        features,
        v_records,
        v_features,
    )
    if gaussian % per_view < trainable:
        row = gaussian / per_view * trainable + gaussian % per_view
        record = records[gaussian]
        sums = v_records[row]
        v_record = sums
        v_record[0] = record[2] * sums[1] + record[3] * sums[2]
        v_record[1] = record[3] * sums[1] + record[4] * sums[2]
        v_record[2] = -0.5 * sums[3]
        v_record[3] = -sums[4]
        v_record[4] = -0.5 * sums[5]
        v_record[5] = 0.0
        if sums[0] != 0.0:
            v_record[5] = sums[0] / record[5]
        v_records[row] = v_record
