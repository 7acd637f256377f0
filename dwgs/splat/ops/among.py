"""Frozen Gaussians dealt out once, to be drawn with splats again and again; on a CPU."""

from typing import Any

import torch
import warp as wp

from dwgs.splat.constants import TILE
from dwgs.splat.kernels import among_cpu as kernels
from dwgs.splat.ops.composite import PLANES, bin, canvas_of
from dwgs.splat.parallel import launch
from dwgs.splat.splats import Layers, Projected, View

BLOCKS = 16
"""Of 4x4 pixels in a tile."""


def deal(among: Projected, view: View, layers: Layers | None) -> Any:
    """Gaussians as a single ``view`` sees them, for the kernels: by the blocks that they touch between the ``layers``.

    Takes 4 bytes for every block that one touches, and 20 for every pixel.
    """
    records, (across, down) = among.records[None].contiguous(), view.tiles
    ends = torch.zeros(BLOCKS * across * down, dtype=torch.int32)
    dealt = kernels.Among()
    dealt.records = wp.from_torch(records[0], dtype=kernels.record16)
    dealt.ends = wp.from_torch(ends)
    inputs = [canvas_of(view, records, layers, torch.zeros(0, 0)), bin(records, view, None, 1).to_warp(), dealt]
    tiles, cpu = [0, across * down], wp.get_device("cpu")
    launch(kernels.deal_among, tiles, inputs, cpu, 1)  # counts
    ends.cumsum_(0)
    dealt.members = wp.from_torch(torch.empty(int(ends[-1]), dtype=torch.int32))
    launch(kernels.deal_among, tiles, inputs, cpu, 1)
    dealt.begins = wp.from_torch(torch.full_like(ends, -1))
    dealt.back = wp.from_torch(torch.empty(PLANES * across * down * TILE**2))
    return dealt
