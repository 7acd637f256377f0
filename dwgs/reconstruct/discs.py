"""Points become small discs that together close a surface."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dwgs.scene import Gaussians

NEIGHBOURS = 8
"""Points that tell which way the surface faces."""
COVERAGE = 0.45
"""Standard deviation of a disc, in mean distances to its neighbours: closes the rings of a LiDAR, too."""
THINNEST = 0.2
"""Of a disc's thickness to its radius: rough surfaces get thicker ones."""
SH_DC = 0.28209479177387814
"""Y_00: a colour c is the coefficient (c - 0.5) / Y_00."""


def discs(points: NDArray[np.float64], sizes: NDArray[np.float64], opacity: float) -> Gaussians:
    """One grey disc on each of ``points`` [N, 3] [m], along the surface that its neighbours span.

    Args:
        points: At least two.
        sizes: [N] [m] about how far apart points should lie here; bounds the radii.
        opacity: Of all.
    """
    count = min(NEIGHBOURS, len(points) - 1)
    distances, index = KDTree(points).query(points, k=count + 1, workers=-1)
    offsets = points[index] - points[index].mean(1, keepdims=True)
    variances, axes = np.linalg.eigh(np.swapaxes(offsets, 1, 2) @ offsets)
    roughness = np.sqrt(np.maximum(variances[:, 0], 0) / np.maximum(variances[:, 1], 1e-12))
    radii = np.clip(COVERAGE * distances[:, 1:].mean(1), 0.3 * sizes, 1.5 * sizes)
    thickness = radii * np.clip(roughness, THINNEST, 1)
    return Gaussians(
        points.astype(np.float32),
        _quats_onto(axes[:, :, 0]),
        np.stack([radii, radii, thickness], 1).astype(np.float32),
        np.full(len(points), opacity, np.float32),
        sh_of_color(np.full(points.shape, 0.5)),
    )


def blobs(
    points: NDArray[np.float64], radii: NDArray[np.float64], colors: NDArray[np.float64], opacity: float
) -> Gaussians:
    """A round Gaussian of standard deviation ``radii`` [N] [m] at each of ``points`` [N, 3]."""
    quats = np.zeros((len(points), 4), np.float32)
    quats[:, 0] = 1
    return Gaussians(
        points.astype(np.float32),
        quats,
        np.repeat(radii[:, None], 3, 1).astype(np.float32),
        np.full(len(points), opacity, np.float32),
        sh_of_color(colors),
    )


def sh_of_color(colors: NDArray) -> NDArray[np.float32]:
    """Degree 1 coefficients [N, 4, 3] that show ``colors`` [N, 3] from every side."""
    sh = np.zeros((len(colors), 4, 3), np.float32)
    sh[:, 0] = (colors - 0.5) / SH_DC
    return sh


def _quats_onto(normals: NDArray[np.float64]) -> NDArray[np.float32]:
    """Rotations [N, 4] wxyz that turn z onto ``normals`` [N, 3], of either sign, the short way."""
    x, y, z = np.where(normals[:, 2:] < 0, -normals, normals).T
    quats = np.stack([1 + z, -y, x, np.zeros_like(x)], 1)
    return (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32)
