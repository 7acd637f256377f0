"""Smooth continuation of an image into what is not known of it."""

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad


def fill_smoothly(image: Tensor, weight: Tensor, stride: int = 1) -> Tensor:
    """The image [H, W, C] where ``weight`` [H, W] is 1, a continuation of its surroundings where it is 0.

    Push-pull (Gortler et al., "The Lumigraph", 1996): averages of what is known, ever coarser, fill what the
    finer level lacks; where nothing at all is known the result is 0. A ``stride`` makes pixels of the finest
    level that large; known pixels are smoothed then too.
    """
    height, width = weight.shape
    premultiplied = torch.cat([image * weight[..., None], weight[..., None].to(image)], -1).permute(2, 0, 1)[None]
    if stride > 1:
        premultiplied = avg_pool2d(premultiplied, stride, ceil_mode=True, count_include_pad=False)
    filled = _fill(premultiplied / premultiplied[:, -1:].clamp_min(1))
    filled = interpolate(filled, scale_factor=stride, mode="bilinear", align_corners=False)[..., :height, :width]
    return (filled[0, :-1] / filled[0, -1:].clamp_min(1e-6)).permute(1, 2, 0)


def _fill(premultiplied: Tensor) -> Tensor:
    """[1, C + 1, H, W] with the weight last, weights raised to 1 wherever a coarser level knows something."""
    _, _, height, width = premultiplied.shape
    if height == 1 and width == 1:
        return premultiplied / premultiplied[:, -1:].clamp_min(1e-6)
    even = pad(premultiplied, (0, width % 2, 0, height % 2))
    coarse = 4 * avg_pool2d(even, 2)
    coarse = coarse / coarse[:, -1:].clamp_min(1)
    finer = interpolate(_fill(coarse), scale_factor=2, mode="bilinear", align_corners=False)
    return premultiplied + (1 - premultiplied[:, -1:]) * finer[:, :, :height, :width]
