"""Binning and compositing on a CPU: one launch there, one back, by a crew of threads."""

from typing import Any

import torch
import warp as wp
from torch import Tensor

from dwgs.splat.kernels import composite_cpu as kernels
from dwgs.splat.kernels.gather import slot10
from dwgs.splat.kernels.project import record16
from dwgs.splat.ops.binned import Binned
from dwgs.splat.ops.scratch import largest, scratch
from dwgs.splat.parallel import launch_crew

_RUN = 4096
"""At least so many Gaussians are dealt out by one thread at a time."""
_RUNS_PER_THREAD = 4
_CPU = torch.device("cpu")


def draw(
    canvas: Any, records: Tensor, image: Tensor, _capacity: int | None, threads: int, _trains: bool = False
) -> Binned:
    """Bin records [V, N, 16] and fill the ``image``, which may be empty: then nothing is drawn.

    Room for the intersections is as large as it ever was; where that is too little, they are counted and it is tried
    once more.
    """
    n, tiles = records.shape[0] * records.shape[1], len(records) * canvas.tiles_across * canvas.tiles_down
    run = max(_RUN, -(-n // (threads * _RUNS_PER_THREAD)))
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
        launch_crew(kernels.composite, [canvas, binned.to_warp(), _records(records), run, *outputs], threads)
        count = int(total)
        if count <= room:
            return Binned(ends, gaussians[:count], isects[:count], ranges)


def draw_adjoint(
    canvas: Any,
    binned: Binned,
    records: Tensor,
    image: Tensor,
    v_image: Any,
    v_records: Tensor,
    v_features: Tensor,
    threads: int,
) -> None:
    """Fill the gradients [V, T, 16] and [V, T, F] of the first T Gaussians of each view."""
    count, trainable, features = len(binned.gaussian_from_isect), *v_features.shape[1:]
    slots = scratch("slots", 10 * count, torch.float32, _CPU).view(-1, 10)
    feature_slots = scratch("feature_slots", features * count, torch.float32, _CPU)
    outputs = [
        wp.from_torch(slots, dtype=slot10, return_ctype=True),
        wp.from_torch(feature_slots, return_ctype=True),
        _records(v_records),
        wp.from_torch(v_features.flatten(0, 1), return_ctype=True),
    ]
    ends = wp.from_torch(binned.ends, return_ctype=True)
    flat = wp.from_torch(image.view(-1), return_ctype=True)
    inputs = [canvas, binned.to_warp(), _records(records), flat, v_image, trainable, ends, *outputs]
    launch_crew(kernels.composite_adjoint, inputs, threads)


def _records(records: Tensor) -> Any:
    return wp.from_torch(records.view(-1, 16), dtype=record16, return_ctype=True)
