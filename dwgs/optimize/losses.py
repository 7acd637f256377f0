"""Photometric losses: images [H, W, 3], weights [H, W], divided by the sum of the weights."""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2
"""Keep the quotients of SSIM finite where an image is black or flat."""
BLOCK = 4
"""Pixels; two blocks make a window."""


def weighted_l1(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean absolute error."""
    return ((rgb - target).abs().sum(-1) * weight).sum() / (3 * weight.sum().clamp_min(1))


def weighted_mse(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean squared error."""
    return ((rgb - target).square().sum(-1) * weight).sum() / (3 * weight.sum().clamp_min(1))


def dssim(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean of (1 - SSIM) / 2 over windows of 8 x 8 pixels, 4 apart (Wang et al., 2004).

    A fit evaluates it at every step: flat windows on a grid cost a tenth of Gaussian ones around every pixel
    and teach the same. Pixels of no weight are taken from the target, so windows never see them.
    """
    rgb = torch.where(weight[..., None] > 0, rgb, target)
    x, y = rgb.permute(2, 0, 1), target.permute(2, 0, 1)
    moments = _window_means(torch.cat([x, y, x * x, y * y, x * y]))
    mean_x, mean_y, square_x, square_y, product = moments.split(len(x))
    variance_x, variance_y = square_x - mean_x**2, square_y - mean_y**2
    covariance = product - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x**2 + mean_y**2 + SSIM_C1)
    structure = (2 * covariance + SSIM_C2) / (variance_x + variance_y + SSIM_C2)
    weight = _window_means(weight[None])[0]
    return ((1 - (luminance * structure).mean(0)) * weight).sum() / (2 * weight.sum().clamp_min(1e-6))


def _window_means(planes: Tensor) -> Tensor:
    """Means [C, H', W'] of planes [C, H, W] over windows of two by two blocks; those at the rim are cut."""
    blocks = avg_pool2d(planes[None], BLOCK, ceil_mode=True)
    return avg_pool2d(blocks, 2, 1, padding=1, count_include_pad=False)[0]
