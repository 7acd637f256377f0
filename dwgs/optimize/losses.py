"""Photometric losses: images [H, W, 3], weights [H, W], divided by the sum of the weights.

A gradient flows to the first image alone. Float32 takes one pass forward and one back, `dssim` on a CPU only;
anything else takes torch's many.
"""

from functools import partial
from typing import Any

import torch
import warp as wp
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import avg_pool2d

from dwgs.optimize.kernels import photometric_cpu, photometric_cuda
from dwgs.splat.ops.stream import torch_stream

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
"""Keep the quotients of SSIM finite where an image is black or flat."""


def weighted_l1(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean absolute error."""
    return _weighted_error(rgb, target, weight, squared=False)


def weighted_mse(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean squared error."""
    return _weighted_error(rgb, target, weight, squared=True)


def dssim(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean of (1 - SSIM) / 2 over windows of 8 x 8 pixels, 4 apart (Wang et al., 2004).

    A fit evaluates it at every step: flat windows on a grid cost a tenth of Gaussian ones around every pixel
    and teach the same. Pixels of no weight are taken from the target, so windows never see them.
    """
    if rgb.dtype == torch.float32 and not rgb.is_cuda:
        blocks = _Moments.apply(rgb, target, weight)
    else:
        x, y = torch.where(weight[..., None] > 0, rgb, target).permute(2, 0, 1), target.permute(2, 0, 1)
        blocks = _block_means(torch.cat([x, y, x * x, y * y, x * y]))
    mean_x, mean_y, square_x, square_y, product = _window_means(blocks).split(3)
    variance_x, variance_y = square_x - mean_x**2, square_y - mean_y**2
    covariance = product - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x**2 + mean_y**2 + SSIM_C1)
    structure = (2 * covariance + SSIM_C2) / (variance_x + variance_y + SSIM_C2)
    weight = _window_means(_block_means(weight[None]))[0]
    return ((1 - (luminance * structure).mean(0)) * weight).sum() / (2 * weight.sum().clamp_min(1e-6))


def _weighted_error(rgb: Tensor, target: Tensor, weight: Tensor, squared: bool) -> Tensor:
    if rgb.dtype == torch.float32:
        return _Error.apply(rgb, target, weight, squared)
    error = (rgb - target).square() if squared else (rgb - target).abs()
    return (error.sum(-1) * weight).sum() / (3 * weight.sum().clamp_min(1))


class RetainedMse:
    """`weighted_mse` of the same images on a CPU, again and again as they change; leaves its gradient in ``v_rgb``.

    Images are [H, W, 3] plane by plane, as the renderer stores them.
    """

    def __init__(self, rgb: Tensor, target: Tensor, weight: Tensor, v_rgb: Tensor) -> None:
        share = weight / (3 * weight.sum().clamp_min(1))
        self._sums = torch.zeros(len(weight), 2)
        outputs = [wp.from_torch(v_rgb.movedim(-1, 0)), wp.from_torch(self._sums, dtype=wp.vec2)]
        inputs = [*_images(rgb, target, share), 1, *outputs]
        command: Any = wp.launch(
            photometric_cpu.error, len(weight), inputs, device="cpu", record_tape=False, record_cmd=True
        )
        self._run = command.launch

    def __call__(self) -> float:
        """The error as the images are now."""
        self._run()
        return self._sums[:, 0].sum().item()


class _Error(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rgb: Tensor, target: Tensor, weight: Tensor, squared: bool) -> Tensor:
        v_rgb, sums = rgb.new_empty(3, *weight.shape), rgb.new_empty(len(weight), 2)
        inputs = [*_images(rgb, target, weight), int(squared), wp.from_torch(v_rgb), wp.from_torch(sums, dtype=wp.vec2)]
        if rgb.is_cuda:
            loss, block = rgb.new_empty(2), photometric_cuda.BLOCK
            run = partial(wp.launch, device=wp.device_from_torch(rgb.device), block_dim=block, record_tape=False)
            with torch_stream(rgb.device):
                run(photometric_cuda.error, block * len(sums), inputs)
                run(photometric_cuda.mean, block, [inputs[-1], wp.from_torch(loss)])
            mean, share = loss
        else:
            _run(photometric_cpu.error, len(sums), inputs)
            total, total_weight = sums.sum(0)
            share = 1 / (3 * total_weight.clamp_min(1.0))
            mean = total * share
        ctx.save_for_backward(v_rgb, share)
        return mean

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor):  # pyright: ignore[reportIncompatibleMethodOverride]
        v_rgb, share = ctx.saved_tensors
        return (v_rgb * (grad_outputs[0] * share)).movedim(0, -1), None, None, None


class _Moments(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
        height, width = (-(-size // photometric_cpu.BLOCK) for size in weight.shape)
        moments = torch.empty(3 * photometric_cpu.MOMENTS, height, width)
        ctx.inputs, ctx.height = _images(rgb, target, weight), height
        ctx.save_for_backward(rgb, target, weight)
        _run(photometric_cpu.moments, height, [*ctx.inputs, wp.from_torch(moments, return_ctype=True)])
        return moments

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Tensor):  # pyright: ignore[reportIncompatibleMethodOverride]
        _, _, weight = ctx.saved_tensors
        v_rgb = torch.empty(3, *weight.shape)
        v_moments = wp.from_torch(grad_outputs[0].contiguous(), return_ctype=True)
        _run(
            photometric_cpu.moments_adjoint,
            ctx.height,
            [*ctx.inputs, v_moments, wp.from_torch(v_rgb, return_ctype=True)],
        )
        return v_rgb.movedim(0, -1), None, None


def _run(kernel: Any, rows: int, inputs: list[Any]) -> None:
    wp.launch(kernel, rows, inputs, device="cpu", record_tape=False)  # too little work to share


def _images(rgb: Tensor, target: Tensor, weight: Tensor) -> list[Any]:
    """What a kernel takes: two images as planes, and weights."""
    planes = [image.detach().movedim(-1, 0) for image in (rgb, target)]
    planes = [image if image.stride(-1) == 1 else image.contiguous() for image in planes]
    return [wp.from_torch(tensor) for tensor in (*planes, weight.contiguous())]


def _block_means(planes: Tensor) -> Tensor:
    """Means [C, H', W'] of planes [C, H, W] over blocks; those at the rim are cut."""
    return avg_pool2d(planes[None], photometric_cpu.BLOCK, ceil_mode=True)[0]


def _window_means(blocks: Tensor) -> Tensor:
    """Means over windows of two by two blocks; those at the rim are cut."""
    return avg_pool2d(blocks[None], 2, 1, padding=1, count_include_pad=False)[0]
