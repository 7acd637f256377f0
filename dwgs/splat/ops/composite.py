"""Records to an image, differentiably."""

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.splat.kernels import composite_cpu, composite_cuda
from dwgs.splat.kernels.canvas import Canvas
from dwgs.splat.kernels.gather import gather, slot10
from dwgs.splat.kernels.project import record16
from dwgs.splat.ops.bin import Binned, bin
from dwgs.splat.ops.scratch import scratch
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import CHUNKS_PER_THREAD, launch, load
from dwgs.splat.splats import Layers, Projected, Rendering, View, whole_tiles, write_planes


def composite(
    projected: Projected | list[Projected], view: View, layers: Layers | None = None, threads: int = 2
) -> Rendering:
    """The image of records, near over far, between the ``layers`` of a frozen scene where they are given.

    Of several ``projected`` (all made with this view) the image is that of their union; a gradient flows to
    those that require one, and the others cost less.
    """
    parts = projected if isinstance(projected, list) else [projected]
    return Rendering(*_Composite.apply(view, layers, threads, *(p.records for p in parts)))


_SCHEMES = {"cpu": composite_cpu, "cuda": composite_cuda}
"""Same kernels by name, a tile being a task on the one and a block on the other."""


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: View, layers: Layers | None, threads: int, *parts: Tensor):
        needs = ctx.needs_input_grad[3:]
        order = sorted(range(len(parts)), key=lambda k: not needs[k])  # trainable first
        records = parts[0].contiguous() if len(parts) == 1 else torch.cat([parts[k] for k in order])
        records = records.detach()
        load(wp.device_from_torch(records.device))
        image = torch.empty(5, *whole_tiles(view.height, view.width), device=records.device)
        with torch_stream(records.device):
            binned = bin(records, view, threads)
            inputs = [_canvas(view, layers), binned.to_warp(), _records(records), _flat(image)]
            spans = binned.chunks(threads * CHUNKS_PER_THREAD)
            _draw("composite", inputs, spans, records.device, threads)
        ctx.inputs, ctx.binned, ctx.spans, ctx.threads = inputs, binned, spans, threads
        ctx.counts = [len(p) if need else 0 for p, need in zip(parts, needs, strict=True)]
        ctx.save_for_backward(records, image)
        ctx.set_materialize_grads(False)
        inside = image[:, : view.height, : view.width]
        return inside[:3].permute(1, 2, 0), inside[3], inside[4]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor | None):  # pyright: ignore[reportIncompatibleMethodOverride]
        records, image = (t.detach() for t in ctx.saved_tensors)
        binned: Binned = ctx.binned
        where, trainable = records.device, sum(ctx.counts)
        v_image = scratch("v_image", image.numel(), torch.float32, where).view(image.shape)
        write_planes(v_image, *grad_outputs)
        split = _SCHEMES[where.type].SLOTS
        slots = scratch("slots", 10 * split * len(binned.gaussian_from_isect), torch.float32, where)
        in_slots = wp.from_torch(slots.view(-1, 10), dtype=slot10, return_ctype=True)
        inputs = [*ctx.inputs, _flat(v_image), trainable, in_slots]
        v_records = torch.empty(trainable, 16, device=where)
        order = wp.from_torch(binned.gaussian_from_rank, return_ctype=True)
        ends = wp.from_torch(binned.ends, return_ctype=True)
        to_gather = [in_slots, order, ends, split, _records(v_records)]
        with torch_stream(where):
            _draw("composite_adjoint", inputs, ctx.spans, where, ctx.threads)
            launch(gather, len(records), to_gather, wp.device_from_torch(where), ctx.threads)
        v_parts = v_records.split(ctx.counts)
        return None, None, None, *(v if len(v) else None for v in v_parts)


def _draw(name: str, inputs: list[Any], spans: list[int], where: torch.device, threads: int) -> None:
    """Run one of the two loops over all tiles, cut into ``spans`` of equal work, as the device likes it."""
    device, scheme = wp.device_from_torch(where), _SCHEMES[where.type]
    kernel = getattr(scheme, name)
    if scheme is composite_cpu:
        launch(kernel, spans, inputs, device, threads)
    else:
        pixels = spans[-1] * composite_cuda.BLOCK
        wp.launch(kernel, pixels, inputs, device=device, block_dim=composite_cuda.BLOCK, record_tape=False)


def _canvas(view: View, layers: Layers | None) -> Any:
    canvas = Canvas()
    canvas.width, canvas.height, canvas.tiles_across = view.width, view.height, view.tiles[0]
    canvas.layered = int(layers is not None)
    if layers is not None:
        canvas.front, canvas.back = wp.from_torch(layers.front.view(-1)), wp.from_torch(layers.back.view(-1))
    return canvas


def _records(records: Tensor) -> Any:
    return wp.from_torch(records, dtype=record16, return_ctype=True)


def _flat(image: Tensor) -> Any:
    return wp.from_torch(image.view(-1), return_ctype=True)
