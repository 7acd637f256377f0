"""Splats and a camera to records, differentiably."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.scene import InputError
from dwgs.splat.kernels import project as kernels
from dwgs.splat.kernels.lanes import LANES
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import even, launch, load
from dwgs.splat.splats import Objects, Projected, Splats, View

_GAUSSIANS_PER_TASK = {"cpu": 256, "cuda": 1}
"""Over so many the adjoint sums the pose's gradient at once; fixed, so that threads do not change sums."""
_WORTH_A_THREAD = 32768
"""Gaussians whose projection takes longer than to hand them over."""


def project(
    splats: Splats, view: View, *, objects: Objects | None = None, antialiased: bool = False, threads: int = 2
) -> Projected:
    """One record per view and Gaussian; a gradient flows to ``splats``, to ``view.viewmat`` and to the objects' poses.

    Colour is evaluated in the direction from the camera to the mean, in the frame of the Gaussian's own object,
    and its gradient reaches means and poses through that direction too. Gaussians that are not finite are not
    drawn.

    Args:
        splats: In the world, or each in the frame of its object.
        view: The camera, or a batch of them.
        objects: Whose Gaussians are whose, and where they stand; by default all belong to the world.
        antialiased: Whether what is thinner than a pixel is fainter instead of fatter (Mip-Splatting's 2D filter).
        threads: On a CPU.
    """
    tensors, objects = checked(splats, view, objects)
    records = _Project.apply(view, objects, antialiased, threads, *tensors)
    return Projected(records if view.is_batch else records.squeeze(0))  # whose gradient, unlike that of [0], is a view


def checked(splats: Splats, view: View, objects: Objects | None) -> tuple[tuple[Tensor, ...], Objects]:
    """Means, quats, scales, opacities, sh and ``camera_from_object`` [V, K, 4, 4]; and whose Gaussians are whose."""
    tensors = (splats.means, splats.quats, splats.scales, splats.opacities, splats.sh, view.viewmat)
    for tensor in tensors:
        if tensor.dtype != torch.float32 or tensor.device != view.viewmat.device:
            raise InputError(
                f"splats and viewmat are float32 on one device, got {tensor.dtype} on {tensor.device} "
                f"and a viewmat on {view.viewmat.device}"
            )
    if objects is None:
        objects = Objects((len(splats),), torch.eye(4, device=view.viewmat.device)[None])
        viewmats = view.viewmats[:, None]
    else:
        viewmats = view.viewmats[:, None] @ objects.world_from_object
    if sum(objects.counts) != len(splats):
        raise InputError(f"every Gaussian belongs to one object: {len(splats)} Gaussians, {objects.counts} in objects")
    return (*tensors[:5], viewmats), objects


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: View, objects: Objects, antialiased: bool, threads: int, *tensors: Tensor) -> Tensor:
        tensors = tuple(t.detach().contiguous() for t in tensors)
        records = torch.empty(len(view.viewmats), len(tensors[0]), 16, device=tensors[0].device)
        load(wp.device_from_torch(records.device))
        subject = Subject.of(view, objects, antialiased, tensors)
        with torch_stream(records.device):
            project_into(records, subject, threads)
        # not the records: whoever keeps its own output is never freed
        ctx.subject, ctx.threads = subject, threads
        ctx.save_for_backward(*tensors, records)
        return records

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor):  # pyright: ignore[reportIncompatibleMethodOverride]
        *tensors, records = (t.detach() for t in ctx.saved_tensors)
        gradient = SubjectGradient.of(ctx.subject, tensors, ctx.needs_input_grad[-1])
        with torch_stream(records.device):
            project_adjoint(gradient, ctx.subject, records, grad_outputs[0].contiguous(), ctx.threads)
        return None, None, None, None, *gradient.tensors()


@dataclass(frozen=True)
class Subject:
    """What is projected, as the kernels take it; who made it keeps the tensors."""

    cloud: Any
    lens: Any
    objects: Objects

    @staticmethod
    def of(view: View, objects: Objects, antialiased: bool, tensors: Sequence[Tensor]) -> "Subject":
        """Of contiguous ``tensors`` as `checked` gives them."""
        return Subject(_cloud(tensors), _lens(view, objects, antialiased, tensors[5]), objects)

    @staticmethod
    @cache
    def empty() -> "Subject":
        """Nothing, seen by nobody."""
        return Subject(kernels.Cloud(), kernels.Lens(), Objects((0,), torch.eye(4)[None]))


@dataclass(frozen=True)
class SubjectGradient:
    """Room for the gradient of a subject."""

    v_tensors: list[Tensor]
    """By means, quats, scales, opacities, sh."""
    v_spans: Tensor
    """[V, T, 4, 4] by the pose, of every span; no spans where nobody asks."""
    needs_pose: bool
    object_from_span: Tensor
    """[T]."""
    spans: Any
    """[T] first and end of Gaussians of one object."""
    v_cloud: Any
    out_spans: Any
    objects: Objects

    @staticmethod
    def of(
        subject: Subject, tensors: Sequence[Tensor], needs_pose: bool, v_tensors: list[Tensor] | None = None
    ) -> "SubjectGradient":
        """Of the tensors that the subject was made of, in room that is there already or is made."""
        where = tensors[0].device
        object_from_span, spans = _tasks(subject.objects.counts, _GAUSSIANS_PER_TASK[where.type], where)
        v_tensors = v_tensors or [torch.empty_like(t) for t in tensors[:5]]
        v_spans = torch.empty(len(tensors[5]), len(spans) if needs_pose else 0, 4, 4, device=where)
        return SubjectGradient(
            v_tensors,
            v_spans,
            needs_pose,
            object_from_span,
            wp.from_torch(spans, dtype=wp.vec2i),
            _cloud(v_tensors),
            wp.from_torch(v_spans, dtype=wp.mat44, return_ctype=True),
            subject.objects,
        )

    def tensors(self) -> list[Tensor | None]:
        """By the tensors of the subject; by the poses None where nobody asked."""
        if not self.needs_pose:
            return [*self.v_tensors, None]
        if len(self.objects.counts) == 1:
            return [*self.v_tensors, self.v_spans.sum(1, keepdim=True)]
        v_viewmats = self.v_spans.new_zeros(len(self.v_spans), len(self.objects.counts), 4, 4)
        return [*self.v_tensors, v_viewmats.index_add_(1, self.object_from_span, self.v_spans)]


def project_into(records: Tensor, subject: Subject, threads: int) -> None:
    """Write the records of a subject, which come first in each view's [V, N, 16]."""
    where = records.device
    lanes = LANES[where.type]
    groups = len(records) * -(-sum(subject.objects.counts) // lanes)
    bounds = even(groups, _WORTH_A_THREAD // lanes, threads)
    inputs = [subject.cloud, subject.lens, records.shape[1], as_records(records)]
    launch(kernels.project, bounds, inputs, wp.device_from_torch(where), threads)


def project_adjoint(
    gradient: SubjectGradient, subject: Subject, records: Tensor, v_records: Tensor, threads: int
) -> None:
    """Fill a gradient from that by the subject's records, [V, T, 16]."""
    where, tasks = records.device, len(gradient.object_from_span)
    inputs = [subject.cloud, subject.lens, records.shape[1], as_records(records), as_records(v_records)]
    inputs += [gradient.spans, gradient.v_cloud, gradient.out_spans]
    bounds = even(tasks, max(1, _WORTH_A_THREAD // _GAUSSIANS_PER_TASK[where.type]), threads)
    launch(kernels.project_adjoint, bounds, inputs, wp.device_from_torch(where), threads)


def as_records(records: Tensor) -> Any:
    """[..., 16] for the kernels."""
    return wp.from_torch(records.view(-1, 16), dtype=kernels.record16, return_ctype=True)


@lru_cache(16)
def _tasks(counts: tuple[int, ...], most: int, where: torch.device) -> tuple[Tensor, Tensor]:
    """Work cut into spans of at most ``most`` Gaussians of one object: object [T], first and end [T, 2] int32."""
    lengths = torch.tensor(counts)
    pieces = -(-lengths // most)
    owner = torch.arange(len(lengths)).repeat_interleave(pieces)
    number = torch.arange(len(owner)) - (pieces.cumsum(0) - pieces)[owner]
    starts = lengths.cumsum(0) - lengths
    first = starts[owner] + number * most
    end = torch.minimum(first + most, (starts + lengths)[owner])
    return owner.to(where), torch.stack([first, end], 1).int().contiguous().to(where)


def _cloud(tensors: Sequence[Tensor]) -> Any:
    means, quats, scales, opacities, sh = tensors[:5]
    cloud = kernels.Cloud()
    cloud.means = wp.from_torch(means, dtype=wp.vec3)
    cloud.quats = wp.from_torch(quats, dtype=wp.vec4)
    cloud.scales = wp.from_torch(scales, dtype=wp.vec3)
    cloud.opacities = wp.from_torch(opacities)
    cloud.sh = wp.from_torch(sh, dtype=wp.vec3)
    return cloud


def _lens(view: View, objects: Objects, antialiased: bool, viewmats: Tensor) -> Any:
    lens = kernels.Lens()
    lens.intrinsics = wp.from_torch(view.lenses, dtype=wp.vec4)
    lens.viewmats = wp.from_torch(viewmats, dtype=wp.mat44)
    lens.object_from_gaussian = wp.from_torch(objects.object_from_gaussian)
    lens.width, lens.height = float(view.width), float(view.height)
    lens.antialiased = int(antialiased)
    return lens
