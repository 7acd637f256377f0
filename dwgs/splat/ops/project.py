"""Splats and a camera to records, differentiably."""

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable

from dwgs.splat.kernels import project as kernels
from dwgs.splat.parallel import launch, load
from dwgs.splat.splats import Projected, Splats, View

_CHUNK = {"cpu": 1024, "cuda": 1}
"""Gaussians whose share of the camera's gradient one task sums; fixed, so that sums do not depend on threads."""


def project(splats: Splats, view: View, threads: int = 2) -> Projected:
    """One record per Gaussian; a gradient flows to every field of ``splats`` and to ``view.viewmat``.

    Colour is evaluated in the direction from the camera to the mean, in the splats' own frame, and its gradient reaches
    means and camera through that direction too. Gaussians that are not finite are not drawn.
    """
    tensors = (splats.means, splats.quats, splats.scales, splats.opacities, splats.sh, view.viewmat)
    return Projected(_Project.apply(view, threads, *tensors))


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(ctx, view: View, threads: int, *tensors: Tensor) -> Tensor:
        tensors = tuple(t.detach().contiguous() for t in tensors)
        records = torch.empty(len(tensors[0]), 12, device=tensors[0].device)
        device = wp.device_from_torch(records.device)
        load(device)
        out = wp.from_torch(records, dtype=kernels.record12, return_ctype=True)
        launch(
            kernels.project, len(records), [_cloud(tensors), _lens(view, tensors[5]), out], device, threads
        )
        ctx.view, ctx.threads = view, threads
        ctx.save_for_backward(*tensors, records)
        return records

    @staticmethod
    @once_differentiable
    def backward(ctx, v_records: Tensor):
        *tensors, records = (t.detach() for t in ctx.saved_tensors)
        device = wp.device_from_torch(records.device)
        chunk = _CHUNK[records.device.type]
        tasks = -(-len(records) // chunk)
        gradients = [torch.empty_like(t) for t in tensors[:5]]
        v_viewmats = torch.empty(tasks, 4, 4, device=records.device)
        v_records = v_records.contiguous()
        inputs = [
            _cloud(tensors),
            _lens(ctx.view, tensors[5]),
            wp.from_torch(records, dtype=kernels.record12, return_ctype=True),
            wp.from_torch(v_records, dtype=kernels.record12, return_ctype=True),
            chunk,
            _cloud(gradients),
            wp.from_torch(v_viewmats, dtype=wp.mat44, return_ctype=True),
        ]
        launch(kernels.project_adjoint, tasks, inputs, device, ctx.threads)
        return None, None, *gradients, v_viewmats.sum(0)


def _cloud(tensors) -> kernels.Cloud:
    cloud = kernels.Cloud()
    cloud.means = wp.from_torch(tensors[0], dtype=wp.vec3)
    cloud.quats = wp.from_torch(tensors[1], dtype=wp.vec4)
    cloud.scales = wp.from_torch(tensors[2], dtype=wp.vec3)
    cloud.opacities = wp.from_torch(tensors[3])
    cloud.sh = wp.from_torch(tensors[4], dtype=wp.vec3)
    return cloud


def _lens(view: View, viewmat: Tensor) -> kernels.Lens:
    lens = kernels.Lens()
    lens.viewmat = wp.from_torch(viewmat.view(1, 4, 4), dtype=wp.mat44)
    lens.intrinsics = wp.vec4(*view.intrinsics)
    lens.width, lens.height = float(view.width), float(view.height)
    return lens
