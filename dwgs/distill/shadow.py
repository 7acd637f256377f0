"""Where the Gaussians of the shadow begin."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dwgs.distill.shots import Sight
from dwgs.scene import Gaussians
from dwgs.scene.pose import transform_points
from dwgs.scene.silhouette import NEAR, box_silhouette
from dwgs.splat.constants import SH_C0

SPACING = 0.08
"""Between shadow Gaussians [m]."""
LIFT = 0.04
"""Height above the ground [m]: sorted by centre, a disc in the road would sink into it."""
DARKNESS = 0.03
"""Grey value of a shadow; its opacity is learnt."""


def initialize_shadow(size: NDArray, margin: float, sights: Sequence[Sight]) -> Gaussians:
    """Faint dark discs flat on the ground, up to ``margin`` [m] around the box, where a shadow can be learnt.

    That is where the frames see the ground beside the box, and their regions reach; with no margin, nowhere.
    """
    half = np.asarray(size, np.float64) / 2 + margin
    x, y = (np.arange(SPACING / 2 - float(h), float(h), SPACING) for h in half[:2])
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    means = np.column_stack([grid, np.full(len(grid), LIFT - size[2] / 2)])
    means = means[_is_exposed(means, size, sights) & (margin > 0)].astype(np.float32)
    n = len(means)
    return Gaussians(
        means,
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.tile(np.array([0.7 * SPACING, 0.7 * SPACING, 0.01], np.float32), (n, 1)),
        np.full(n, 0.05, np.float32),
        np.full((n, 1, 3), (DARKNESS - 0.5) / SH_C0, np.float32),
    )


def _is_exposed(places: NDArray, size: NDArray, sights: Sequence[Sight]) -> NDArray[np.bool_]:
    """[N] whether any frame sees a place beside the box, and half that could have it in their regions."""
    could, does = np.zeros(len(places)), np.zeros(len(places))
    beside = np.zeros(len(places), bool)
    for sight in sights:
        if sight.held_out:
            continue
        region, window = sight.region, sight.region.window
        inside = window.camera(sight.camera)
        pixels, depth = sight.camera.project(transform_points(sight.world_from_vehicle, places))
        could += sight.camera.contains(pixels) & (depth > NEAR)
        pixels -= (window.x, window.y)
        in_window = inside.contains(pixels) & (depth > NEAR)
        column, row = np.floor(pixels[in_window]).astype(int).T
        mask = region.reactive if region.reactive.any() else region.supervised
        does[in_window] += mask[row, column]
        box = box_silhouette(inside, sight.world_from_vehicle, size)
        beside[in_window] |= (mask & ~box)[row, column]
    return beside & (does >= could / 2)
