"""Records to an image, differentiably."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.scene import InputError
from dwgs.splat.kernels.canvas import Canvas, Gradient
from dwgs.splat.ops import composite_cpu, composite_cuda
from dwgs.splat.ops.binned import Binned
from dwgs.splat.ops.project import Subject
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import load
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
            step can be captured in a graph; `Rendering.intersections` tells afterwards whether it was enough. A CPU
            makes room as it needs.
        threads: On a CPU.
    """
    parts = projected if isinstance(projected, list) else [projected]
    features = checked(features, sum(map(len, parts)), parts[0].records)
    images = _Composite.apply(view, layers, capacity, threads, features, *(p.records for p in parts))
    return Rendering(*images)


def checked(features: Tensor | None, count: int, like: Tensor) -> Tensor:
    """[N, F] features of so many Gaussians, none of each where there are none."""
    if features is None:
        return like.new_zeros(count, 0)
    if features.shape[:1] != (count,) or features.ndim != 2 or features.dtype != torch.float32:
        raise InputError(f"features are float32 [{count}, F], got {features.dtype} {tuple(features.shape)}")
    return features


WAYS = {"cpu": composite_cpu, "cuda": composite_cuda}
"""Of doing the same."""
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
        canvas = canvas_of(view, records, layers, feature)
        with torch_stream(where):
            way, needs_any = WAYS[where.type], any(ctx.needs_input_grad)
            binned = way.draw(canvas, Subject.empty(), records, image, capacity, threads, needs_any)
        ctx.canvas, ctx.binned, ctx.threads = canvas, binned, threads
        ctx.order, ctx.counts, ctx.needs, ctx.shapes = order, counts, needs, [part.shape for part in parts]
        ctx.save_for_backward(records, image, feature)
        ctx.size = view.height, view.width
        ctx.set_materialize_grads(False)
        images = pictures(image, binned, view)
        ctx.mark_non_differentiable(images[-1])
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor | None):  # pyright: ignore[reportIncompatibleMethodOverride]
        records, image, feature = (t.detach() for t in ctx.saved_tensors)
        binned, where = ctx.binned, records.device
        trainable = sum(count for count, need in zip(ctx.counts, ctx.needs, strict=True) if need)
        v_image = gradient_of(grad_outputs[:4], (len(image), image.shape[1], *ctx.size), where)
        v_records = torch.empty(len(records), trainable, 16, device=where)
        v_features = torch.empty(len(records), trainable, feature.shape[1], device=where)
        with torch_stream(where):
            way = WAYS[where.type]
            inputs = ctx.canvas, Subject.empty(), binned, records, image, v_image
            way.draw_adjoint(*inputs, v_records, v_features, None, ctx.threads)
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


def pictures(image: Tensor, binned: Binned, view: View) -> tuple[Tensor, ...]:
    """What a `Rendering` has, of planes [V, 5 + F, H', W']."""
    inside = image[..., : view.height, : view.width]
    inside = inside if view.is_batch else inside[0]
    rgb, rest = inside[..., :3, :, :].movedim(-3, -1), inside[..., PLANES:, :, :].movedim(-3, -1)
    intersections = binned.ends[-1].long() if len(binned.ends) else binned.ends.sum()
    return rgb, inside[..., 3, :, :], inside[..., 4, :, :], rest, intersections


def gradient_of(images: Sequence[Tensor | None], shape: tuple[int, ...], where: torch.device) -> Any:
    """For the kernels, the gradients by rgb, depth, alpha and features: as a `Rendering` has them, where they lie.

    None stands for zeros; ``shape`` is V, planes, H, W.
    """
    views, planes, height, width = shape
    gradient = Gradient()
    for name, count, image in zip(("rgb", "depth", "alpha", "features"), (3, 1, 1, planes - 5), images, strict=True):
        if image is None:
            image = _zero(where).expand(views, height, width, count)
        image = image.reshape(views, height, width, count).movedim(-1, 1)
        setattr(gradient, name, wp.from_torch(image))
    return gradient


@cache
def _zero(where: torch.device) -> Tensor:
    return torch.zeros(1, device=where)


def bin(records: Tensor, view: View, capacity: int | None, threads: int) -> Binned:
    """Which tiles the records [V, N, 16] touch, nearest first; without a ``capacity`` a GPU is waited for."""
    load(wp.device_from_torch(records.device))
    canvas = canvas_of(view, records, None, records.new_zeros(0, 0))
    return WAYS[records.device.type].draw(canvas, Subject.empty(), records, records.new_zeros(0), capacity, threads)


def canvas_of(view: View, records: Tensor, layers: Layers | None, feature: Tensor) -> Any:
    """Where the records [V, N, 16] are drawn, for the kernels."""
    canvas = Canvas()
    canvas.width, canvas.height = view.width, view.height
    canvas.tiles_across, canvas.tiles_down = view.tiles
    canvas.gaussians = records.shape[1]
    if layers is not None:
        canvas.has_back, canvas.back = 1, wp.from_torch(layers.back.view(-1))
        if layers.front is not None:
            canvas.has_front, canvas.front = 1, wp.from_torch(layers.front.view(-1))
    canvas.features, canvas.feature = feature.shape[1], wp.from_torch(feature.view(-1))
    return canvas
