"""The default backend: the vehicle's own surface, in the recorded light, on the recorded road. No weights."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from dwgs.scene import Camera, Frame, Insertion, Scene
from dwgs.scene.color import linear_from_srgb, srgb_from_linear
from dwgs.scene.pose import inverse, transform_points
from dwgs.scene.sky import pixel_rays
from generator.composite.environment import look_around
from generator.composite.light import Lighting
from generator.composite.occlusion import Recording
from generator.composite.raster import draw, facing
from generator.composite.sensor import Sensor, measure
from generator.composite.surface import surface_of
from generator.composite.transfer import CELL, REACH, Transfer
from generator.conditions.conditions import ConditionFrame, Conditions
from generator.frame_by_frame import frame_by_frame
from generator.generator import Capabilities

BORDER = 1 / 120
"""The shadow fades to nothing within this share of the image height from the border of the reactive mask."""


class CompositeGenerator:
    """Puts a vehicle into recorded frames by reconstructing, lighting and compositing it. Deterministic."""

    name = "composite"
    capabilities = Capabilities(None, 1, "cpu", needs_weights=False, deterministic=True)

    def check(self, scene: Scene) -> list[str]:
        """It works on every drive, and there is nothing to say."""
        return []

    def generate(
        self, conditions: Conditions, seed: int, on_progress: Callable[[int, int], None] | None = None
    ) -> Scene:
        """The recorded scene with the vehicle in it; see `generator.generator.Generator.generate`."""
        scene, insertion = conditions.scene, conditions.insertion
        studio = Studio.prepare(scene, insertion, seed)

        def paint(camera: int, condition: ConditionFrame) -> Frame:
            return studio.take(condition, (seed, camera, condition.frame.index))

        return frame_by_frame(conditions, paint, on_progress)


@dataclass(frozen=True)
class Studio:
    """All that is the same for every frame of a clip: the vehicle, the light, the camera's noise. Thread-safe."""

    insertion: Insertion
    lighting: Lighting
    recording: Recording
    sensor: Sensor

    @staticmethod
    def prepare(scene: Scene, insertion: Insertion, seed: int) -> "Studio":
        """Look at the scene and build the vehicle."""
        transfer = Transfer(surface_of(insertion.vehicle, insertion.size, seed), insertion.size)
        frames = scene.frames[scene.main_camera]
        sensor = measure([f.pixels for f in frames[::8]])
        return Studio(insertion, Lighting(transfer, look_around(scene)), Recording(scene), sensor)

    def take(self, condition: ConditionFrame, seed: tuple[int, ...]) -> Frame:
        """One frame with the vehicle in it."""
        frame, mask = condition.frame, condition.load_reactive_mask()
        pixels = frame.pixels
        if mask.any():
            top, bottom, left, right = _bounds(mask)
            window = np.s_[top:bottom, left:right]
            camera = frame.camera.crop(left, top, right - left, bottom - top)
            # the image's own border is no border of the mask
            around = np.pad(mask, 1, mode="edge")[top : bottom + 2, left : right + 2]
            inside = np.asarray(distance_transform_edt(around))[1:-1, 1:-1]
            image = self._picture(
                frame, camera, pixels[window], np.clip(inside / (BORDER * frame.camera.height), 0, 1), seed
            )
            pixels = pixels.copy()
            pixels[window] = np.where(mask[window][..., None], image, pixels[window])
        return replace(frame, load_pixels=lambda: pixels.copy(), load_reactive_mask=lambda: mask.copy())

    def _picture(
        self,
        frame: Frame,
        camera: Camera,
        recorded: NDArray[np.uint8],
        strength: NDArray,
        seed: tuple[int, ...],
    ) -> NDArray[np.uint8]:
        """The part [h, w, 3] of a frame that ``camera`` sees, with the vehicle and its shadow."""
        pose = self.insertion.trajectory.at(camera.time)
        surface = self.lighting.transfer.surface
        seen = facing(surface, camera, pose)
        colors = self.lighting.shade(pose, camera.position, seen)
        vehicle, depth, alpha = draw(surface, seen, colors, camera, pose)
        light, ground_depth = self._ground(camera, pose)
        image = recorded / np.float32(255)
        is_vehicle = alpha > 0.05
        asked = np.where(is_vehicle, depth, np.where(light.min(-1) < 0.999, ground_depth, np.inf))
        shown = 1 - self.recording.hides(camera, frame.index, pose, self.insertion.size, image, asked)
        light = 1 - (1 - light) * (strength * shown)[..., None]
        alpha = (alpha * shown)[..., None]
        mixed = srgb_from_linear(alpha * vehicle + (1 - alpha) * linear_from_srgb(image) * light)
        mixed = mixed + alpha * (self.sensor.expose(mixed, seed) - mixed)
        return np.rint(255 * np.clip(mixed, 0, 1)).astype(np.uint8)

    def _ground(self, camera: Camera, pose: NDArray) -> tuple[NDArray, NDArray]:
        """Light left [h, w, 3] where pixels see the ground the vehicle stands on, and its depth [h, w] [m]."""
        vehicle_from_world = inverse(pose)
        eye = transform_points(vehicle_from_world, camera.position[None])[0]
        rays = pixel_rays(camera) @ vehicle_from_world[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (-self.insertion.size[2] / 2 - eye[2]) / rays[..., 2]
        depth = np.where(depth > 0, depth, np.inf)
        xy = np.where(
            np.isfinite(depth)[..., None],
            eye[:2] + rays[..., :2] * np.where(np.isfinite(depth), depth, 0)[..., None],
            1e6,
        )
        at = np.moveaxis((xy + self.insertion.size[:2] / 2 + REACH) / CELL - 0.5, -1, 0)
        left = self.lighting.ground(pose)
        return np.stack([map_coordinates(left[..., c], at, order=1, cval=1.0) for c in range(3)], -1), depth


def _bounds(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Top, bottom, left, right of the smallest window that holds a mask [H, W]."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
