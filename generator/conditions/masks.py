"""Where a generator may paint."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Camera
from dwgs.scene.silhouette import box_silhouette
from generator.conditions.raster import GREY

BOX_MARGIN = 1.5
"""How far [px] the outline of the box is moved outwards: a disc on its edge reaches so far."""

SHADOW_MARGIN = 0.6
"""How far [m] the ground beside the box belongs to the region: contact shadow and a short cast one."""

_SLAB = (
    0.15,
    0.05,
)  # the ground beside the box lies so far [m] below and above its wheels: streets are crowned


def reactive_mask(
    camera: Camera,
    world_from_vehicle: NDArray[np.float64],
    size: NDArray[np.float64],
    shadow_margin: float = SHADOW_MARGIN,
) -> NDArray[np.bool_]:
    """Silhouette [H, W] of the vehicle's box and of the ground around it.

    Args:
        camera: Where it is seen from.
        world_from_vehicle: [4, 4] pose of the box centre.
        size: [3] (length, width, height) [m].
        shadow_margin: Ground around the box [m]; 0 leaves the box alone.
    """
    mask = box_silhouette(camera, world_from_vehicle, size, BOX_MARGIN)
    if shadow_margin > 0:
        below, above = _SLAB
        world_from_slab = world_from_vehicle.copy()
        world_from_slab[:3, 3] -= world_from_vehicle[:3, 2] * (size[2] / 2 + (below - above) / 2)
        slab = np.array([size[0] + 2 * shadow_margin, size[1] + 2 * shadow_margin, below + above])
        mask |= box_silhouette(camera, world_from_slab, slab)
    return mask


def inactive_image(pixels: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The recorded image [H, W, 3] with mid-grey where it may be repainted."""
    return np.where(mask[..., None], np.uint8(GREY), pixels)
