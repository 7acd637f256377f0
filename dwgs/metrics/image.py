"""PSNR and SSIM, whole or inside a mask. Images are float arrays [H, W, 3] in [0, 1]."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

RADIUS, SIGMA = 5, 1.5
"""Gaussian window of 11 x 11 px of the paper (Wang et al. 2004); the image goes on by reflection."""
C1, C2 = 0.01**2, 0.03**2
"""The paper's constants for values in [0, 1]."""


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
    x, y = (np.moveaxis(np.clip(a, 0, 1).astype(np.float32), -1, 0) for a in (image, reference))
    mean_x, mean_y = _mean_near(x), _mean_near(y)
    variances = _mean_near(x * x) - mean_x**2 + _mean_near(y * y) - mean_y**2
    covariance = _mean_near(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    values = (luminance * (2 * covariance + C2) / (variances + C2)).mean(0)
    if mask is not None:
        values = values[mask]
    return float(values.mean()) if values.size else math.nan


def _mean_near(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of planes [C, H, W] under the window about each pixel."""
    return np.asarray(gaussian_filter(planes, SIGMA, mode="mirror", radius=RADIUS, axes=(1, 2)), np.float32)
