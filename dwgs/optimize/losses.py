"""Photometric losses: images [H, W, 3], weights [H, W], divided by the sum of the weights."""

import torch
from kornia.metrics import ssim as ssim_map
from torch import Tensor

from dwgs.metrics.image import SSIM_WINDOW


def weighted_l1(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean absolute error."""
    return ((rgb - target).abs().sum(-1) * weight).sum() / (3 * weight.sum().clamp_min(1))


def weighted_mse(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean squared error."""
    return ((rgb - target).square().sum(-1) * weight).sum() / (3 * weight.sum().clamp_min(1))


def dssim(rgb: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean of (1 - SSIM) / 2. Pixels of no weight are taken from the target, so windows never see them."""
    rgb = torch.where(weight[..., None] > 0, rgb, target)
    pair = (x.permute(2, 0, 1)[None] for x in (rgb, target))
    similarity = ssim_map(*pair, SSIM_WINDOW)[0].mean(0)
    return ((1 - similarity) * weight).sum() / (2 * weight.sum().clamp_min(1))
