"""HUGSIM's way to a vehicle in a frame: render a Gaussian asset over the recording, with a flat shadow beneath it.

It knows nothing of the street's light: what it looks like was decided where the asset was made.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.scene import Frame, Gaussians, Insertion, Scene, VehicleAsset
from dwgs.scene.pose import pose
from dwgs.splat import Splats, View, render
from generator.asset.gaussians import asset_of, contact_shadow
from generator.composite.occlusion import Recording
from generator.conditions.conditions import ConditionFrame, Conditions
from generator.frame_by_frame import frame_by_frame
from generator.generator import Capabilities


class AssetGenerator:
    """Renders a Gaussian asset into recorded frames. Deterministic."""

    name = "asset"
    capabilities = Capabilities(None, 1, "cpu", needs_weights=False, deterministic=True)

    def __init__(self, asset: VehicleAsset | None = None) -> None:
        """Of ``asset``, or of one made from the inserted vehicle's points."""
        self._asset = asset

    def check(self, scene: Scene) -> list[str]:
        """It works on every drive, and there is nothing to say."""
        return []

    def generate(
        self, conditions: Conditions, seed: int, on_progress: Callable[[int, int], None] | None = None
    ) -> Scene:
        """The recorded scene with the asset in it; see `generator.generator.Generator.generate`."""
        scene, insertion = conditions.scene, conditions.insertion
        asset = self._asset or asset_of(insertion.vehicle, insertion.size, seed)
        shadow = asset.shadow if len(asset.shadow) else contact_shadow(asset.size)
        stage = _Stage(insertion, replace(asset, shadow=shadow, shading=None), Recording(scene))
        return frame_by_frame(conditions, lambda _, condition: stage.take(condition), on_progress)


@dataclass(frozen=True)
class _Stage:
    """All that is the same for every frame of a clip. Thread-safe."""

    insertion: Insertion
    asset: VehicleAsset
    """What is drawn."""
    recording: Recording

    def take(self, condition: ConditionFrame) -> Frame:
        """One frame with the asset in it."""
        frame, mask = condition.frame, condition.load_reactive_mask()
        pixels = frame.pixels
        if mask.any():
            rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
            window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            image = self._picture(frame, int(columns[0]), int(rows[0]), pixels[window])
            pixels = pixels.copy()
            pixels[window] = np.where(mask[window][..., None], image, pixels[window])
        return replace(frame, load_pixels=lambda: pixels.copy(), load_reactive_mask=lambda: mask.copy())

    def _picture(self, frame: Frame, x: int, y: int, recorded: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The window [h, w, 3] of a frame at (x, y) with the asset before what was recorded there."""
        height, width = recorded.shape[:2]
        camera = frame.camera.crop(x, y, width, height)
        trajectory, asset = self.insertion.trajectory, self.asset
        world_from_vehicle = trajectory.at(camera.time)
        lift = (asset.size[2] - self.insertion.size[2]) / 2  # both stand on the same ground
        world_from_asset = world_from_vehicle @ pose(np.eye(3), (0, 0, lift))
        cloud = Gaussians.concatenate([*asset.parts_at(trajectory, camera.time), asset.shadow])
        with torch.no_grad():
            seen = render(Splats.from_gaussians(cloud), View.from_camera(camera, world_from_asset), threads=1)
        rgb, alpha = seen.rgb.numpy(), seen.alpha.numpy()
        depth = np.where(alpha > 0.05, seen.expected_depth.numpy(), np.inf)
        image = recorded / np.float32(255)
        hidden = self.recording.hides(
            camera, frame.index, world_from_vehicle, self.insertion.size, image, depth.astype(np.float64)
        )
        mixed = (1 - hidden)[..., None] * (rgb - alpha[..., None] * image) + image
        return np.rint(255 * np.clip(mixed, 0, 1)).astype(np.uint8)
