# type: ignore  (Warp's language, which is not Python's)
"""Gradients of intersections to gradients of Gaussians, without atomics: deterministic, safe in threads."""

import warp as wp

from dwgs.splat.kernels.project import record16

wp.set_module_options({"enable_backward": False})

slot10 = wp.types.vector(length=10, dtype=float)
"""Gradient of the first ten fields of a record."""


@wp.kernel
def gather(
    first: int,
    slots: wp.array(dtype=slot10),
    gaussian_from_rank: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    parts: int,
    # outputs
    v_records: wp.array(dtype=record16),
):
    """Sum the slots of each Gaussian, ``parts`` per intersection; those beyond ``v_records`` are frozen."""
    rank = first + wp.tid()
    gaussian = gaussian_from_rank[rank]
    if gaussian < v_records.shape[0]:
        begin = int(0)  # noqa: RUF046, UP018  (a variable, not a constant)
        if rank > 0:
            begin = ends[rank - 1]
        total = slot10()
        for k in range(begin * parts, ends[rank] * parts):
            total += slots[k]
        v_records[gaussian] = record16(
            total[0], total[1], total[2], total[3], total[4], total[5],
            total[6], total[7], total[8], total[9], 0.0, 0.0,
            0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
