"""PSNR and SSIM, whole or inside a mask. Images are float arrays [H, W, 3] in [0, 1]."""

import math

import numpy as np
import torch
from kornia.metrics import ssim as ssim_map
from numpy.typing import NDArray

SSIM_WINDOW = 11
"""Gaussian window [px] of the paper (Wang et al. 2004), sigma 1.5; kornia pads by reflection."""


def psnr(image: NDArray, reference: NDArray, mask: NDArray | None = None) -> float:
    """Peak signal-to-noise ratio [dB] over the pixels where ``mask`` [H, W] is True (all when None).

    Infinite for equal images; NaN where the mask is empty.
    """
    error = (np.clip(image, 0, 1).astype(np.float64) - reference) ** 2
    if mask is not None:
        error = error[mask]
    if error.size == 0:
        return math.nan
    mse = float(error.mean())
    return math.inf if mse == 0 else -10 * math.log10(mse)


def ssim(image: NDArray, reference: NDArray, mask: NDArray | None = None) -> float:
    """Structural similarity: the map of the whole image, averaged over the mask [H, W] (all when None)."""
    pair = [torch.from_numpy(np.clip(x, 0, 1).astype(np.float32)).permute(2, 0, 1)[None] for x in (image, reference)]
    values = ssim_map(*pair, SSIM_WINDOW)[0].mean(0).numpy()
    if mask is not None:
        values = values[mask]
    return float(values.mean()) if values.size else math.nan
