"""Splats to an image in one go, differentiably."""

from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.splat.ops import composite, project
from dwgs.splat.ops.composite import PLANES, WAYS, canvas_of, gradient_of, pictures
from dwgs.splat.ops.project import Subject, SubjectGradient
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import load
from dwgs.splat.splats import Layers, Objects, Projected, Rendering, Splats, View, whole_tiles


def render(
    splats: Splats,
    view: View,
    layers: Layers | None = None,
    *,
    among: Projected | None = None,
    objects: Objects | None = None,
    antialiased: bool = False,
    features: Tensor | None = None,
    capacity: int | None = None,
    threads: int = 2,
) -> Rendering:
    """The image of ``splats`` in ``view``; a gradient flows to every field of both, and to the objects' poses.

    The same as `project` and then `composite`, in less time: see there for ``objects`` and ``antialiased``, and for
    ``layers``, ``features`` [N, F] and ``capacity``.

    Args:
        splats: In the world, or each in the frame of its object.
        view: The camera, or a batch of them.
        layers: What stands before and behind all of it.
        among: Further Gaussians as this view sees them, which stay as they are; their features follow those of the
            splats.
        objects: Whose Gaussians are whose, and where they stand.
        antialiased: Whether what is thinner than a pixel is fainter instead of fatter.
        features: Further channels.
        capacity: Room for intersections on a GPU.
        threads: On a CPU.
    """
    tensors, objects = project.checked(splats, view, objects)
    count = len(splats) + (0 if among is None else len(among))
    features = composite.checked(features, count, splats.means)
    others = None if among is None else among.records
    return Rendering(*_Render.apply(view, objects, antialiased, layers, others, capacity, threads, features, *tensors))


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        view: View,
        objects: Objects,
        antialiased: bool,
        layers: Layers | None,
        others: Tensor | None,
        capacity: int | None,
        threads: int,
        features: Tensor,
        *tensors: Tensor,
    ):
        tensors = tuple(t.detach().contiguous() for t in tensors)
        feature, where, views = features.detach().contiguous(), tensors[0].device, len(view.viewmats)
        load(wp.device_from_torch(where))
        records = torch.empty(views, len(feature), 16, device=where)
        if others is not None:
            records[:, len(tensors[0]) :] = others.detach()
        image = torch.empty(views, PLANES + feature.shape[1], *whole_tiles(view.height, view.width), device=where)
        canvas, subject = canvas_of(view, records, layers, feature), Subject.of(view, objects, antialiased, tensors)
        with torch_stream(where):
            needs_any = any(ctx.needs_input_grad)
            binned = WAYS[where.type].draw(canvas, subject, records, image, capacity, threads, needs_any)
        ctx.canvas, ctx.subject, ctx.binned, ctx.threads = canvas, subject, binned, threads
        ctx.size = view.height, view.width
        ctx.save_for_backward(records, image, feature, *tensors)
        ctx.set_materialize_grads(False)
        images = pictures(image, binned, view)
        ctx.mark_non_differentiable(images[-1])
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor | None):  # pyright: ignore[reportIncompatibleMethodOverride]
        records, image, feature, *tensors = (t.detach() for t in ctx.saved_tensors)
        where, count = records.device, len(tensors[0])
        needs_features, needs_pose = ctx.needs_input_grad[7], ctx.needs_input_grad[-1]
        trainable = len(feature) if needs_features else count
        v_image = gradient_of(grad_outputs[:4], (len(image), image.shape[1], *ctx.size), where)
        v_records = torch.empty(len(records), trainable, 16, device=where)
        v_features = torch.empty(len(records), trainable, feature.shape[1], device=where)
        v_subject = SubjectGradient.of(ctx.subject, tensors, needs_pose)
        with torch_stream(where):
            inputs = ctx.canvas, ctx.subject, ctx.binned, records, image, v_image
            WAYS[where.type].draw_adjoint(*inputs, v_records, v_features, v_subject, ctx.threads)
        return *[None] * 7, v_features.sum(0) if needs_features else None, *v_subject.tensors()
