"""What the recording camera adds to an image: blur and noise, measured on its own frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

BLOCK = 8
"""Noise is measured in squares of so many pixels."""


@dataclass(frozen=True)
class Sensor:
    """How a camera differs from a perfect one."""

    noise: float
    """Standard deviation of sRGB values in flat, unsaturated areas, in [0, 1]."""

    def expose(self, image: NDArray, seed: tuple[int, ...]) -> NDArray[np.float32]:
        """An sRGB image [H, W, 3] with this camera's noise: brightness alone, a little smooth."""
        rng = np.random.default_rng(seed)
        grain = gaussian_filter(rng.standard_normal(image.shape[:2]).astype(np.float32), 0.5)
        grain *= self.noise / max(float(grain.std()), 1e-6)
        return (image + grain[..., None]).astype(np.float32)


def measure(images: list[NDArray[np.uint8]]) -> Sensor:
    """The sensor that took these images [H, W, 3]: the noise of their flattest tenth."""
    levels = []
    for image in images:
        gray = image.mean(2) / 255
        height, width = (n // BLOCK * BLOCK for n in gray.shape)
        blocks = gray[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK)
        mean, spread = blocks.mean((1, 3)), (gray - gaussian_filter(gray, 1.0))[:height, :width]
        deviation = spread.reshape(blocks.shape).std((1, 3))
        usable = deviation[(mean > 0.08) & (mean < 0.85)]
        if len(usable):
            levels.append(np.quantile(usable, 0.1))
    return Sensor(float(np.clip(np.median(levels), 0, 0.02)) if levels else 0.0)
