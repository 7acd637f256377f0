"""Projecting, binning and compositing on a CPU: one launch there, one back, by a crew of threads."""

from typing import Any

import torch
import warp as wp
from torch import Tensor

from dwgs.splat import crew
from dwgs.splat.kernels import composite_cpu as kernels
from dwgs.splat.kernels.among_cpu import Among
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.ops.binned import Binned
from dwgs.splat.ops.project import Subject, SubjectGradient, as_records
from dwgs.splat.ops.scratch import largest, scratch

_RUN = 2048
"""At least so many Gaussians are dealt out by one thread at a time."""
_RUNS_PER_THREAD = 4
_CPU = torch.device("cpu")
_NOTHING = [torch.zeros(0, *shape) for shape in ((3,), (4,), (3,), (), (1, 3), (1, 4, 4))]


def run_size(gaussians: int, threads: int) -> int:
    """How many are dealt out as one item."""
    return max(_RUN, -(-gaussians // (threads * _RUNS_PER_THREAD)))


def draw(
    canvas: Any,
    subject: Subject,
    records: Tensor,
    image: Tensor,
    _capacity: int | None,
    threads: int,
    _trains: bool = False,
) -> Binned:
    """Project a subject to the first of the records [V, N, 16], bin all and fill the ``image``, which may be empty.

    Room for the intersections is as large as it ever was; where that is too little, they are counted and it is tried
    once more.
    """
    n, tiles = records.shape[0] * records.shape[1], len(records) * canvas.tiles_across * canvas.tiles_down
    run = run_size(n, threads)
    ends, ranges = torch.empty(n, dtype=torch.int32), torch.empty(tiles, 2, dtype=torch.int32)
    places = scratch("places", -(-n // run) * tiles, torch.int32, _CPU).view(-(-n // run), tiles)
    total = torch.zeros(1, dtype=torch.int32)
    while True:
        room = largest("intersections", int(total))
        isects, gaussians = torch.empty(room, dtype=torch.int32), torch.empty(room, dtype=torch.int32)
        binned = Binned(ends, gaussians, isects, ranges)
        spares = [scratch(name, room, torch.float32, _CPU) for name in ("depths", "spare_depths")]
        spares.append(scratch("spare_isects", room, torch.int32, _CPU))
        outputs = [wp.from_torch(t, return_ctype=True) for t in (ends, places, *spares, image.view(-1), total)]
        inputs = [subject.cloud, subject.lens, canvas, binned.to_warp(), run, Among(), as_records(records), *outputs]
        crew.pack(kernels.composite, inputs, threads)()
        count = int(total)
        if count <= room:
            return Binned(ends, gaussians[:count], isects[:count], ranges)


def draw_adjoint(
    canvas: Any,
    subject: Subject,
    binned: Binned,
    records: Tensor,
    image: Tensor,
    v_image: Any,
    v_records: Tensor,
    v_features: Tensor,
    v_subject: SubjectGradient | None,
    threads: int,
) -> None:
    """Fill the gradients [V, T, 16] and [V, T, F] of the first T Gaussians of each view, and that of the subject."""
    count, trainable, features = len(binned.gaussian_from_isect), *v_features.shape[1:]
    slots = scratch("slots", 10 * count, torch.float32, _CPU).view(-1, 10)
    feature_slots = scratch("feature_slots", features * count, torch.float32, _CPU)
    ends = wp.from_torch(binned.ends, return_ctype=True)
    flat = wp.from_torch(image.view(-1), return_ctype=True)
    inputs = [
        subject.cloud,
        subject.lens,
        canvas,
        binned.to_warp(),
        as_records(records),
        Among(),
        flat,
        v_image,
        trainable,
        ends,
    ]
    outputs = [
        wp.from_torch(slots, dtype=slot10, return_ctype=True),
        wp.from_torch(feature_slots, return_ctype=True),
        as_records(v_records),
        wp.from_torch(v_features.flatten(0, 1), return_ctype=True),
    ]
    v_subject = v_subject or SubjectGradient.of(Subject.empty(), _NOTHING, False)
    outputs += [v_subject.v_cloud, v_subject.out_spans]
    crew.pack(kernels.composite_adjoint, [*inputs, v_subject.spans, *outputs], threads)()
