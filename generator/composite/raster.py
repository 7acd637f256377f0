"""Discs to pixels, through the splatter."""

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from dwgs.scene import Camera
from dwgs.scene.pose import inverse, transform_points
from dwgs.splat import Splats, View, render
from generator.composite.surface import Surface

SH_C0 = 0.28209479177387814
"""Spherical harmonic of degree 0."""
SPREAD, THICKNESS = 1.0, 0.2
"""Standard deviations of a disc across and along its normal, in radii: closed, and thin at the rim."""
OPACITY = 0.9
"""Of one disc: the next ones shine through a little, or their order would fray every edge of paint."""
SUPERSAMPLING = 2
"""Pixels drawn across one pixel of the result: the splatter's low-pass alone would soften its edges."""
FOOTPRINT, RESTORED = 1.0, 0.8
"""Discs blur what they carry over about a pixel; an unsharp mask of that width [px] gives so much of it back."""
SOLID = 0.7
"""Discs that overlap reach about this opacity between them; it counts as opaque."""


def facing(surface: Surface, camera: Camera, pose: NDArray) -> NDArray[np.int64]:
    """Discs [S] of a surface at ``world_from_vehicle`` [4, 4] that turn their front to a camera."""
    eye = transform_points(inverse(pose), camera.position[None])[0].astype(np.float32)
    return np.flatnonzero(((eye - surface.points) * surface.normals).sum(1) > 0)


def draw(
    surface: Surface, seen: NDArray, colors: NDArray, camera: Camera, pose: NDArray
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Colour [H, W, 3], depth [H, W] [m] and coverage [H, W] in [0, 1] of a surface at a pose [4, 4].

    Args:
        surface: The discs.
        seen: Which of them are drawn [S].
        colors: Their linear colours [S, 3].
        camera: Sees them.
        pose: Where they stand.
    """
    normals, radii = surface.normals[seen], surface.radii[seen, None]
    # the shortest rotation that takes z to the normal; straight down any half turn does
    quats = np.stack([1 + normals[:, 2], -normals[:, 1], normals[:, 0], np.zeros(len(normals))], 1)
    quats[normals[:, 2] < -0.9999] = (0, 1, 0, 0)
    fields = (
        surface.points[seen], quats, radii * np.array([SPREAD, SPREAD, THICKNESS], np.float32),
        np.full(len(normals), OPACITY), ((colors - 0.5) / SH_C0)[:, None],
    )  # fmt: skip
    splats = Splats(*(torch.from_numpy(np.ascontiguousarray(f, np.float32)) for f in fields))
    fine = camera.resize(SUPERSAMPLING * camera.width, SUPERSAMPLING * camera.height)
    with torch.no_grad():
        image = render(splats, View.from_camera(fine, pose), threads=1)
    alpha = image.alpha.numpy()
    gain = np.clip(alpha / SOLID, 0, 1) / np.maximum(alpha, 1e-6)
    coverage = _mean(alpha * gain)
    colors, depth = _mean(image.rgb.numpy() * gain[..., None]), _mean(image.depth.numpy() * gain)
    share = np.maximum(coverage, 1e-6)
    colors /= share[..., None]
    depth /= share
    return _restored(colors, coverage), depth, coverage


def _restored(colors: NDArray, coverage: NDArray) -> NDArray[np.float32]:
    """Colours [H, W, 3] with the detail that the discs' footprint took; what is not covered does not count."""
    soft = gaussian_filter(colors * coverage[..., None], (FOOTPRINT, FOOTPRINT, 0))
    soft /= np.maximum(gaussian_filter(coverage, FOOTPRINT), 1e-3)[..., None]
    return np.maximum(colors + RESTORED * (colors - soft), 0)


def _mean(image: NDArray) -> NDArray[np.float32]:
    """The image [H, W, ...] of squares of `SUPERSAMPLING` x `SUPERSAMPLING` pixels."""
    height, width = (n // SUPERSAMPLING for n in image.shape[:2])
    return image.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, *image.shape[2:]).mean((1, 3)).astype(np.float32)
