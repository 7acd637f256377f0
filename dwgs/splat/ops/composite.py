"""Records to an image, differentiably."""

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.scene import InputError
from dwgs.splat.kernels import composite_cpu, composite_cuda
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.kernels.gather import gather, slot10
from dwgs.splat.kernels.project import record16
from dwgs.splat.ops.bin import bin
from dwgs.splat.ops.scratch import scratch
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import CHUNKS_PER_THREAD, even, launch, load
from dwgs.splat.splats import Layers, Projected, Rendering, View, whole_tiles


def composite(
    projected: Projected | list[Projected],
    view: View,
    layers: Layers | None = None,
    *,
    features: Tensor | None = None,
    capacity: int | None = None,
    threads: int = 2,
) -> Rendering:
    """The image of records, near over far, between the ``layers`` of a frozen scene where they are given.

    Of several ``projected`` (all made with this view) the image is that of their union; a gradient flows to
    those that require one, and the others cost less.

    Args:
        projected: What is drawn.
        view: The camera, or a batch of them.
        layers: What stands before and behind all of it.
        features: [N, F] further channels of the Gaussians, in order of all ``projected``: composited like colours.
        capacity: Room for so many intersections of Gaussians with tiles. With it a GPU is never waited for, so that a
            step can be captured in a graph; `Rendering.intersections` tells afterwards whether it was enough.
        threads: On a CPU.
    """
    parts = projected if isinstance(projected, list) else [projected]
    if features is None:
        features = parts[0].records.new_zeros(sum(map(len, parts)), 0)
    if features.shape[:1] != (sum(map(len, parts)),) or features.ndim != 2 or features.dtype != torch.float32:
        raise InputError(
            f"features are float32 [{sum(map(len, parts))}, F], got {features.dtype} {tuple(features.shape)}"
        )
    images = _Composite.apply(view, layers, capacity, threads, features, *(p.records for p in parts))
    return Rendering(*images)


_SCHEMES = {"cpu": composite_cpu, "cuda": composite_cuda}
"""Same kernels by name, a tile being a task on the one and a block on the other."""
_WORTH_A_THREAD = 4096
"""Gaussians whose slots take longer to sum up than to hand them over."""
PLANES = 5
"""r, g, b, depth, alpha; features follow."""


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        view: View,
        layers: Layers | None,
        capacity: int | None,
        threads: int,
        features: Tensor,
        *parts: Tensor,
    ):
        needs = [need or ctx.needs_input_grad[4] for need in ctx.needs_input_grad[5:]]
        order = sorted(range(len(parts)), key=lambda k: not needs[k])  # trainable first
        counts = [part.shape[-2] for part in parts]
        pieces = [part.detach() if view.is_batch else part.detach()[None] for part in parts]
        rows = [f.detach() for f in features.split(counts)]
        if len(parts) > 1:
            pieces, rows = [torch.cat([pieces[k] for k in order], 1)], [torch.cat([rows[k] for k in order])]
        records, feature = pieces[0].contiguous(), rows[0].contiguous()
        where, views = records.device, len(records)
        load(wp.device_from_torch(where))
        shape = (views, PLANES + feature.shape[1], *whole_tiles(view.height, view.width))
        image = torch.empty(shape, device=where)
        with torch_stream(where):
            binned = bin(records, view, capacity, threads)
            inputs = [_canvas(view, records, layers, feature), binned.to_warp(), _records(records)]
            spans = binned.chunks(threads * CHUNKS_PER_THREAD) if where.type == "cpu" else [0, len(binned.ranges)]
            _draw("composite", [*inputs, _flat(image)], spans, where, threads)
        ctx.inputs, ctx.binned, ctx.spans, ctx.threads = inputs, binned, spans, threads
        ctx.order, ctx.counts, ctx.needs, ctx.shapes = order, counts, needs, [part.shape for part in parts]
        ctx.save_for_backward(records, image, feature)
        ctx.size = view.height, view.width
        ctx.set_materialize_grads(False)
        inside = image[..., : view.height, : view.width]
        inside = inside if view.is_batch else inside[0]
        rgb, rest = inside[..., :3, :, :].movedim(-3, -1), inside[..., PLANES:, :, :].movedim(-3, -1)
        intersections = binned.ends[-1:].sum()
        ctx.mark_non_differentiable(intersections)
        return rgb, inside[..., 3, :, :], inside[..., 4, :, :], rest, intersections

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor | None):  # pyright: ignore[reportIncompatibleMethodOverride]
        records, image, feature = (t.detach() for t in ctx.saved_tensors)
        binned, where = ctx.binned, records.device
        trainable = sum(count for count, need in zip(ctx.counts, ctx.needs, strict=True) if need)
        v_image = _gradient(grad_outputs[:4], (len(image), image.shape[1], *ctx.size), where)
        split = _SCHEMES[where.type].SLOTS
        count = split * len(binned.gaussian_from_isect)
        slots = scratch("slots", 10 * count, torch.float32, where).view(-1, 10)
        feature_slots = scratch("feature_slots", feature.shape[1] * count, torch.float32, where)
        in_slots = [wp.from_torch(slots, dtype=slot10, return_ctype=True), _flat(feature_slots)]
        inputs = [*ctx.inputs, _flat(image), v_image, trainable, *in_slots]
        v_records = torch.empty(len(records), trainable, 16, device=where)
        v_features = torch.empty(len(records), trainable, feature.shape[1], device=where)
        ends = wp.from_torch(binned.ends, return_ctype=True)
        v_rows = wp.from_torch(v_features.flatten(0, 1), return_ctype=True)
        numbers = [split, records.shape[1], trainable, feature.shape[1]]
        to_gather = [*in_slots, ends, *numbers, _records(v_records), v_rows]
        with torch_stream(where):
            _draw("composite_adjoint", inputs, ctx.spans, where, ctx.threads)
            bounds = even(len(binned.ends), _WORTH_A_THREAD, ctx.threads)
            launch(gather, bounds, to_gather, wp.device_from_torch(where), ctx.threads)
        return None, None, None, None, *_by_part(ctx, v_records, v_features)


def _by_part(ctx: Any, v_records: Tensor, v_features: Tensor) -> list[Tensor | None]:
    """Gradients of features and parts as they were given, from those of the trainable Gaussians [V, T, ...]."""
    trainable = [k for k in ctx.order if ctx.needs[k]]
    pieces = dict(zip(trainable, v_records.split([ctx.counts[k] for k in trainable], 1), strict=True))
    v_parts = [pieces[k].view(shape) if k in pieces else None for k, shape in enumerate(ctx.shapes)]
    if not ctx.needs_input_grad[4]:
        return [None, *v_parts]
    rows = dict(zip(trainable, v_features.sum(0).split([ctx.counts[k] for k in trainable]), strict=True))
    return [torch.cat([rows[k] for k in range(len(ctx.counts))]), *v_parts]


def _gradient(images: Sequence[Tensor | None], shape: tuple[int, ...], where: torch.device) -> Any:
    """Gradients by rgb [V, H, W, 3], depth and alpha [V, H, W] and features [V, H, W, F], where they lie.

    Where one is None all is zero; without views there is no V.
    """
    views, planes, height, width = shape
    gradient = Gradient()
    for name, count, image in zip(("rgb", "depth", "alpha", "features"), (3, 1, 1, planes - 5), images, strict=True):
        if image is None:
            image = torch.zeros(1, device=where).expand(views, height, width, count)
        image = image.reshape(views, height, width, count).movedim(-1, 1)
        setattr(gradient, name, wp.from_torch(image))
    return gradient


def _draw(name: str, inputs: list[Any], spans: list[int], where: torch.device, threads: int) -> None:
    """Run one of the two loops over all tiles, cut into ``spans`` of equal work, as the device likes it."""
    device, scheme = wp.device_from_torch(where), _SCHEMES[where.type]
    kernel = getattr(scheme, name)
    if scheme is composite_cpu:
        launch(kernel, spans, inputs, device, threads)
    else:
        pixels = spans[-1] * composite_cuda.BLOCK
        wp.launch(kernel, pixels, inputs, device=device, block_dim=composite_cuda.BLOCK, record_tape=False)


def _canvas(view: View, records: Tensor, layers: Layers | None, feature: Tensor) -> Any:
    canvas = Canvas()
    canvas.width, canvas.height = view.width, view.height
    canvas.tiles_across, canvas.tiles_down = view.tiles
    canvas.gaussians = records.shape[1]
    canvas.layered = int(layers is not None)
    if layers is not None:
        canvas.front, canvas.back = wp.from_torch(layers.front.view(-1)), wp.from_torch(layers.back.view(-1))
    canvas.features, canvas.feature = feature.shape[1], wp.from_torch(feature.view(-1))
    return canvas


def _records(records: Tensor) -> Any:
    return wp.from_torch(records.view(-1, 16), dtype=record16, return_ctype=True)


def _flat(image: Tensor) -> Any:
    return wp.from_torch(image.view(-1), return_ctype=True)
