"""What a lacquered surface mirrors of what is around it, and by how much: nothing of this takes the paint's colour.

The share is Schlick's ("An inexpensive BRDF model for physically-based rendering", 1994) for a clear coat; what lies in
the mirrored direction is told apart as coarsely as paint tells it. A street is open at its ends: along it sky comes
lower down than across, and a roof that frames see from behind mirrors sky, but from beside it houses.
"""

import numpy as np
from numpy.typing import NDArray

FACED = 0.04
"""Share that is mirrored where a surface is seen from ahead: a coat's of refractive index 1.5."""
HEIGHTS = (-0.1, 0.1, 0.4)
"""Sines of the elevations at which ground, surroundings and sky alone are mirrored; between them two are."""
PARTS = 4
"""Of the surroundings: the ground, what stands across the vehicle's way and along it, and the sky."""


def mirrored(normals: NDArray, toward: NDArray) -> NDArray[np.float64]:
    """[N, PARTS] by what share surfaces with these normals [N, 3], seen from ``toward`` [N, 3], mirror each part."""
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    cosines = (normals * toward).sum(1)
    x, _, z = (2 * cosines[:, None] * normals - toward).T
    share = FACED + (1 - FACED) * (1 - np.minimum(np.abs(cosines), 1)) ** 5
    low, middle, high = HEIGHTS
    ground, sky = np.clip((middle - z) / (middle - low), 0, 1), np.clip((z - middle) / (high - middle), 0, 1)
    around, along = 1 - ground - sky, np.minimum(x * x, 1)
    return share[:, None] * np.stack([ground, around * (1 - along), around * along, sky], 1)
