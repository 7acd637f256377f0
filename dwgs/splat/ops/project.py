"""Splats and a camera to records, differentiably."""

from collections.abc import Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.scene import InputError
from dwgs.splat.kernels import project as kernels
from dwgs.splat.ops.stream import torch_stream
from dwgs.splat.parallel import CHUNKS_PER_THREAD, launch, load
from dwgs.splat.splats import Projected, Splats, View

_GAUSSIANS_PER_TASK = {"cpu": 1024, "cuda": 1}
"""Over so many the adjoint sums the camera's gradient at once; fixed, so that threads do not change sums."""


def project(splats: Splats, view: View, threads: int = 2) -> Projected:
    """One record per Gaussian; a gradient flows to every field of ``splats`` and to ``view.viewmat``.

    Colour is evaluated in the direction from the camera to the mean, in the splats' own frame, and its
    gradient reaches means and camera through that direction too. Gaussians that are not finite are not
    drawn.
    """
    tensors = (splats.means, splats.quats, splats.scales, splats.opacities, splats.sh, view.viewmat)
    for tensor in tensors:
        if tensor.dtype != torch.float32 or tensor.device != view.viewmat.device:
            raise InputError(
                f"splats and viewmat are float32 on one device, got {tensor.dtype} on {tensor.device} "
                f"and a viewmat on {view.viewmat.device}"
            )
    return Projected(_Project.apply(view, threads, *tensors))


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: View, threads: int, *tensors: Tensor) -> Tensor:
        tensors = tuple(t.detach().contiguous() for t in tensors)
        records = torch.empty(len(tensors[0]), 16, device=tensors[0].device)
        device = wp.device_from_torch(records.device)
        load(device)
        inputs = [_cloud(tensors), _lens(view, tensors[5]), _records(records)]
        with torch_stream(records.device):
            launch(kernels.project, len(records), inputs, device, threads)
        ctx.inputs, ctx.threads = inputs, threads
        ctx.save_for_backward(*tensors, records)
        return records

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor):  # pyright: ignore[reportIncompatibleMethodOverride]
        *tensors, records = (t.detach() for t in ctx.saved_tensors)
        v_records = grad_outputs[0].contiguous()
        per_task = _GAUSSIANS_PER_TASK[records.device.type]
        tasks = -(-len(records) // per_task)
        v_tensors = [torch.empty_like(t) for t in tensors[:5]]
        v_viewmats = torch.empty(tasks, 4, 4, device=records.device)
        in_viewmats = wp.from_torch(v_viewmats, dtype=wp.mat44, return_ctype=True)
        inputs = [*ctx.inputs, _records(v_records), per_task, _cloud(v_tensors), in_viewmats]
        chunks = max(1, min(tasks, ctx.threads * CHUNKS_PER_THREAD))
        bounds = [tasks * k // chunks for k in range(chunks + 1)]
        with torch_stream(records.device):
            launch(kernels.project_adjoint, bounds, inputs, wp.device_from_torch(records.device), ctx.threads)
        return None, None, *v_tensors, v_viewmats.sum(0)


def _cloud(tensors: Sequence[Tensor]) -> Any:
    means, quats, scales, opacities, sh = tensors[:5]
    cloud = kernels.Cloud()
    cloud.means = wp.from_torch(means, dtype=wp.vec3)
    cloud.quats = wp.from_torch(quats, dtype=wp.vec4)
    cloud.scales = wp.from_torch(scales, dtype=wp.vec3)
    cloud.opacities = wp.from_torch(opacities)
    cloud.sh = wp.from_torch(sh, dtype=wp.vec3)
    return cloud


def _lens(view: View, viewmat: Tensor) -> Any:
    lens = kernels.Lens()
    lens.viewmat = wp.from_torch(viewmat.view(1, 4, 4), dtype=wp.mat44)
    lens.intrinsics = wp.vec4(*view.intrinsics)
    lens.width, lens.height = float(view.width), float(view.height)
    return lens


def _records(records: Tensor) -> Any:
    return wp.from_torch(records, dtype=kernels.record16, return_ctype=True)
