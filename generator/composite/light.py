"""A vehicle and its ground in the light of a street: diffuse light, reflections of a clear coat, shadow."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.pose import yaw_rotation
from generator.composite.environment import Environment
from generator.composite.transfer import Transfer, soften

FRESNEL = 0.04
"""Reflectance of a clear coat, and of glass, seen head on."""
MAX_FRESNEL = 0.25
"""Reflectance stays below: at grazing angles real paint is neither flat nor clean."""
GROUND_FADE = 0.35
"""Under a vehicle the ground is dark: its light fades over about this height above it [m]."""
DARKEST = 0.1
"""No shadow takes more than all but this share of the light: lenses flare, streets scatter."""
HEADING_STEP = 0.02
"""[rad]; a turn by less changes no light that anybody sees."""
HEADINGS_KEPT = 4
"""Frames are made a few at a time, and a vehicle may waver between two headings."""


class Lighting:
    """One vehicle in one environment. Light turns slowly, so it is kept for headings `HEADING_STEP` apart."""

    def __init__(self, transfer: Transfer, environment: Environment) -> None:
        self.transfer = transfer
        self.environment = environment
        self._openness = np.clip(transfer.discs.sum(1), 0, 1)
        self._diffuse = lru_cache(HEADINGS_KEPT)(self._irradiance)
        self._ground = lru_cache(HEADINGS_KEPT)(self._ground_light)

    def shade(self, pose: NDArray, eye: NDArray, seen: NDArray) -> NDArray[np.float32]:
        """Linear colours [S, 3] of the discs ``seen`` [S] at a pose [4, 4], from ``eye`` [3] in the world.

        A colour that a camera saw keeps the light it has; a material's is lit. The clear coat mirrors
        the panorama.
        """
        surface = self.transfer.surface
        lit = surface.lit[seen, None]
        colors = surface.colors[seen] * (lit + (1 - lit) * self.diffuse(pose)[seen])
        rotation = pose[:3, :3].astype(np.float32)
        normals = surface.normals[seen] @ rotation.T
        to_eye = (eye - pose[:3, 3]).astype(np.float32) - surface.points[seen] @ rotation.T
        to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
        cosine = np.clip((normals * to_eye).sum(1), 0, 1)
        mirrored = 2 * cosine[:, None] * normals - to_eye
        fresnel = np.minimum(FRESNEL + (1 - FRESNEL) * (1 - cosine) ** 5, MAX_FRESNEL) * surface.gloss[seen]
        height = surface.points[seen, 2] + np.float32(self.transfer.size[2] / 2)
        open_way = self._openness[seen] * np.where(mirrored[:, 2] < 0, _bounce(height), 1)
        coat = self.environment.radiance(mirrored) * open_way[:, None]
        colors += fresnel[:, None] * (coat - colors)
        return np.maximum(colors, self.environment.black)

    def diffuse(self, pose: NDArray) -> NDArray[np.float32]:
        """What a white surface would look like at each disc [N, 3]."""
        return self._diffuse(_heading(pose))

    def ground(self, pose: NDArray) -> NDArray[np.float32]:
        """What the vehicle leaves [X, Y, 3] of the light that the ground around it had, in [0, 1]."""
        return self._ground(_heading(pose))

    def _irradiance(self, heading: float) -> NDArray[np.float32]:
        rotation = yaw_rotation(heading).astype(np.float32)
        transfer, environment = self.transfer, self.environment
        toward, up = transfer.directions, len(transfer.directions) // 2
        radiance = environment.radiance(toward @ rotation.T)
        flat = np.maximum(toward[:, 2], 0) * np.float32(4 / len(toward))
        radiance *= environment.ground / np.maximum(flat @ radiance, 1e-6)
        height = transfer.surface.points[:, 2:] + np.float32(transfer.size[2] / 2)
        total = transfer.discs[:, :up] @ radiance[:up] + _bounce(height) * (transfer.discs[:, up:] @ radiance[up:])
        if environment.sun_direction is not None:
            direction = rotation.T @ environment.sun_direction
            cosine = np.maximum(transfer.surface.normals @ direction, 0) * transfer.sees(direction)
            total += cosine[:, None] * environment.sun
        return total.astype(np.float32)

    def _ground_light(self, heading: float) -> NDArray[np.float32]:
        rotation = yaw_rotation(heading).astype(np.float32)
        transfer, environment = self.transfer, self.environment
        toward = transfer.ground_directions
        radiance = environment.radiance(toward @ rotation.T) * toward[:, 2:]
        radiance *= environment.ground / radiance.sum(0)
        taken = [soften(layer, 0.06) for layer in np.moveaxis(np.tensordot(transfer.ground, radiance, (0, 0)), -1, 0)]
        whole = environment.ground
        if environment.sun_direction is not None:
            direct = environment.sun * environment.sun_direction[2]
            umbra = soften(transfer.shadow(rotation.T @ environment.sun_direction), 0.04)
            taken = [layer + umbra * c for layer, c in zip(taken, direct, strict=True)]
            whole = whole + direct
        return np.clip(1 - np.stack(taken, -1) / whole, DARKEST, 1).astype(np.float32)


def _heading(pose: NDArray) -> float:
    """The heading of a pose [rad], rounded to `HEADING_STEP`."""
    return round(float(np.arctan2(pose[1, 0], pose[0, 0])) / HEADING_STEP) * HEADING_STEP


def _bounce(height: NDArray) -> NDArray:
    """Share of its light that the ground right under a vehicle sends to ``height`` [m] above it."""
    return 1 - np.exp(-height / np.float32(GROUND_FADE))
