"""sRGB and linear light."""

import numpy as np
from numpy.typing import NDArray


def linear_from_srgb(srgb: NDArray) -> NDArray:
    """Linear light for sRGB in [0, 1] (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((np.maximum(srgb, 0) + 0.055) / 1.055) ** 2.4).astype(srgb.dtype)


def srgb_from_linear(linear: NDArray) -> NDArray:
    """SRGB in [0, 1] for linear light, clipped (IEC 61966-2-1)."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055).astype(linear.dtype)


def luminance(linear: NDArray) -> NDArray:
    """Relative luminance [...] of linear colours [..., 3] (ITU-R BT.709)."""
    return linear @ np.array([0.2126, 0.7152, 0.0722], linear.dtype)
