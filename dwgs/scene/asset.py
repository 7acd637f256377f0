"""The vehicle, to take home."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.gaussians import Gaussians


@dataclass(frozen=True)
class VehicleAsset:
    """Gaussians in the vehicle's own frame (box centre, x forward, y left, z up): they need no scene."""

    body: Gaussians
    """What lies on the vehicle."""
    shadow: Gaussians
    """What the vehicle takes away from the ground around it: dark, flat, outside the box."""
    size: NDArray[np.float64]
    """[3] (length, width, height) [m]."""
    category: str = "car"
    """Class of vehicle."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Where it comes from: scene, generator, versions, seed, settings. JSON values."""
    quality: dict[str, Any] = field(default_factory=dict)
    """What was measured: held-out PSNR and SSIM, sides seen, corrections of poses. JSON values."""
    observations: NDArray[np.uint32] | None = None
    """[body] how many frames saw each Gaussian; those that none saw are as they were put there."""

    @property
    def gaussians(self) -> Gaussians:
        """Body and shadow as one cloud."""
        return Gaussians.concatenate([self.body, self.shadow])
