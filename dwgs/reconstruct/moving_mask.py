"""Which pixels show recorded traffic."""

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Frame, Scene
from dwgs.scene.moving import BODY_MARGIN, moving_tracks
from dwgs.scene.silhouette import box_silhouette

SHADOW_MARGIN = 0.5
"""The shadow reaches this far beyond the box on the ground [m]."""
SHADOW_HEIGHT = 0.1
"""Of the slab on the ground that stands for the shadow [m]."""


def moving_mask(scene: Scene, frame: Frame, margin: float = 4.0) -> NDArray[np.bool_]:
    """Pixels [H, W] of whatever moves: every box whose track ever moves, with its shadow on the ground.

    Args:
        scene: Whose tracks are drawn; leave a track out of ``scene.tracks`` to leave it unmasked.
        frame: Its camera and time.
        margin: How far outlines are moved outwards [px]: blur, and the camera's own error of pose.
    """
    camera = frame.camera
    mask = np.zeros((camera.height, camera.width), bool)
    for track in moving_tracks(scene, camera.time):
        world_from_box = track.trajectory.at(camera.time)
        mask |= box_silhouette(camera, world_from_box, track.size + 2 * BODY_MARGIN, margin)
        world_from_slab = world_from_box.copy()
        world_from_slab[:3, 3] -= world_from_box[:3, 2] * (track.size[2] - SHADOW_HEIGHT) / 2
        slab = np.array([*(track.size[:2] + 2 * (BODY_MARGIN + SHADOW_MARGIN)), SHADOW_HEIGHT])
        mask |= box_silhouette(camera, world_from_slab, slab, margin)
    return mask
