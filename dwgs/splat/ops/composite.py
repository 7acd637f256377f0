"""Records to an image, differentiably."""

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.splat.kernels import composite_cpu, composite_cuda
from dwgs.splat.kernels.gather import gather, slot10
from dwgs.splat.kernels.project import record12
from dwgs.splat.ops.bin import Binned, bin
from dwgs.splat.parallel import launch, load
from dwgs.splat.splats import Layers, Projected, Rendering, View, planes

_CHUNKS_PER_THREAD = 4


def composite(
    projected: Projected | list[Projected], view: View, layers: Layers | None = None, threads: int = 2
) -> Rendering:
    """The image of records, near over far, between the ``layers`` of a frozen scene where they are given.

    Of several ``projected`` (all made with this view) the image is that of their union; a gradient flows to those that
    require one, and the others cost less.
    """
    parts = projected if isinstance(projected, list) else [projected]
    return Rendering(*_Composite.apply(view, layers, threads, *(p.records for p in parts)))


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(ctx, view: View, layers: Layers | None, threads: int, *parts: Tensor):
        ctx.parts = [(len(p), needs) for p, needs in zip(parts, ctx.needs_input_grad[3:], strict=True)]
        parts = tuple(p.detach() for p in parts)
        order = sorted(range(len(parts)), key=lambda k: not ctx.parts[k][1])  # trainable first
        records = parts[0].contiguous() if len(parts) == 1 else torch.cat([parts[k] for k in order])
        load(wp.device_from_torch(records.device))
        binned = bin(records, view, threads)
        tiles_across, tiles_down = view.tiles
        image = torch.empty(5, tiles_down * 16, tiles_across * 16, device=records.device)
        _launch_tiles("composite", view, layers, threads, binned, [_records(records), _flat(image)])
        ctx.view, ctx.layers, ctx.threads, ctx.binned = view, layers, threads, binned
        ctx.save_for_backward(records, image)
        image = image[:, : view.height, : view.width]
        return image[:3].permute(1, 2, 0), image[3], image[4]

    @staticmethod
    @once_differentiable
    def backward(ctx, v_rgb: Tensor, v_depth: Tensor, v_alpha: Tensor):
        records, image = (t.detach() for t in ctx.saved_tensors)
        binned: Binned = ctx.binned
        trainable = sum(n for n, needs in ctx.parts if needs)
        v_image = planes(v_rgb, v_depth, v_alpha)
        split = _slots_per_isect(records.device)
        slots = torch.empty(len(binned.gaussian_from_isect) * split, 10, device=records.device)
        warp_slots = wp.from_torch(slots, dtype=slot10, return_ctype=True)
        inputs = [_records(records), _flat(image), _flat(v_image), trainable, warp_slots]
        _launch_tiles("composite_adjoint", ctx.view, ctx.layers, ctx.threads, binned, inputs)

        v_records = torch.empty(trainable, 12, device=records.device)
        inputs = [
            warp_slots,
            wp.from_torch(binned.gaussian_from_rank, return_ctype=True),
            wp.from_torch(binned.ends, return_ctype=True),
            split,
            _records(v_records),
        ]
        launch(gather, len(records), inputs, wp.device_from_torch(records.device), ctx.threads)
        shares = iter(v_records.split([n for n, needs in ctx.parts if needs]))
        return None, None, None, *(next(shares) if needs else None for _, needs in ctx.parts)


def _slots_per_isect(device: torch.device) -> int:
    return composite_cuda.WARPS_PER_TILE if device.type == "cuda" else 1


def _launch_tiles(
    name: str, view: View, layers: Layers | None, threads: int, binned: Binned, inputs: list
) -> None:
    """Run one of the two loops over the tiles, in the scheme of the device."""
    device = wp.device_from_torch(binned.ranges.device)
    canvas = composite_cpu.Canvas()
    canvas.width, canvas.height, canvas.tiles_across = view.width, view.height, view.tiles[0]
    canvas.layered = int(layers is not None)
    if layers is not None:
        canvas.front, canvas.back = wp.from_torch(layers.front.view(-1)), wp.from_torch(layers.back.view(-1))
    inputs = [canvas, binned.to_warp(), *inputs]
    if device.is_cpu:
        launch(
            getattr(composite_cpu, name), binned.chunks(threads * _CHUNKS_PER_THREAD), inputs, device, threads
        )
    else:
        composite_cuda.launch_tiles(getattr(composite_cuda, name), len(binned.ranges), inputs, device)


def _records(records: Tensor):
    return wp.from_torch(records.detach(), dtype=record12, return_ctype=True)


def _flat(image: Tensor):
    return wp.from_torch(image.view(-1), return_ctype=True)
