"""What a generator is told: where the vehicle's points fall, and where it may paint."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Frame, InputError, Insertion, Scene
from generator.conditions.masks import SHADOW_MARGIN, inactive_image, reactive_mask
from generator.conditions.raster import GREY, PointRasterizer


@dataclass(frozen=True)
class ConditionFrame:
    """The conditions of one image."""

    frame: Frame
    """The recorded image."""
    load_point_image: Callable[[], NDArray[np.uint8]] = field(repr=False, compare=False)
    """Reads the vehicle's points [H, W, 3] sRGB on a mid-grey canvas."""
    load_point_mask: Callable[[], NDArray[np.bool_]] = field(repr=False, compare=False)
    """Reads where points drew [H, W]."""
    load_reactive_mask: Callable[[], NDArray[np.bool_]] = field(repr=False, compare=False)
    """Reads where the generator may paint [H, W]."""

    def load_inactive_image(self) -> NDArray[np.uint8]:
        """The recorded image [H, W, 3], mid-grey where the generator may paint."""
        return inactive_image(self.frame.pixels, self.load_reactive_mask())


@dataclass(frozen=True)
class Conditions:
    """A recorded drive, a vehicle on its way through it, and what that looks like in each image."""

    scene: Scene
    """The recording."""
    insertion: Insertion
    """What is put where."""
    frames: dict[str, tuple[ConditionFrame, ...]]
    """Camera name to the conditions of each of the scene's frames, in the same order."""


def make_conditions(
    scene: Scene,
    insertion: Insertion,
    on_progress: Callable[[int, int], None] | None = None,
    shadow_margin: float = SHADOW_MARGIN,
) -> Conditions:
    """Draw the points and masks of an insertion for every frame of a scene.

    Args:
        scene: The recording.
        insertion: What to put where.
        on_progress: Called with (frames done, frames in all).
        shadow_margin: Ground around the vehicle that may be repainted [m].

    Raises:
        InputError: The trajectory does not cover the clip, or no frame sees the vehicle.
    """
    frames = scene.all_frames()
    insertion.trajectory.require(sorted({frame.camera.time for frame in frames}))
    rasterizer = PointRasterizer(insertion.vehicle)

    def draw(frame: Frame) -> _Drawing:
        world_from_vehicle = insertion.trajectory.at(frame.camera.time)
        image, mask = rasterizer.draw(frame.camera, world_from_vehicle)
        reactive = reactive_mask(frame.camera, world_from_vehicle, insertion.size, shadow_margin)
        return _Drawing.of(image, mask, reactive)

    drawings = []
    with ThreadPoolExecutor(2) as pool:
        for drawing in pool.map(draw, frames):
            drawings.append(drawing)
            if on_progress:
                on_progress(len(drawings), len(frames))
    if not any(drawing.point_mask.any() for drawing in drawings):
        raise InputError(_why_unseen(scene, insertion))

    drawn = iter(drawings)
    conditions = {name: tuple(_frame(f, next(drawn)) for f in fs) for name, fs in scene.frames.items()}
    return Conditions(scene, insertion, conditions)


@dataclass(frozen=True)
class _Drawing:
    """Images that are empty outside a window, without their empty part."""

    shape: tuple[int, int]
    window: tuple[slice, slice]
    point_image: NDArray[np.uint8]
    point_mask: NDArray[np.bool_]
    reactive_mask: NDArray[np.bool_]

    @staticmethod
    def of(image: NDArray[np.uint8], mask: NDArray[np.bool_], reactive: NDArray[np.bool_]) -> "_Drawing":
        used = (image != GREY).any(2) | mask | reactive
        rows, columns = np.flatnonzero(used.any(1)), np.flatnonzero(used.any(0))
        window = (slice(0, 0), slice(0, 0))
        if len(rows):
            window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        height, width = mask.shape
        return _Drawing((height, width), window, image[window].copy(), mask[window].copy(), reactive[window].copy())

    def whole(self, part: NDArray, fill: int) -> NDArray:
        image = np.full((*self.shape, *part.shape[2:]), fill, part.dtype)
        image[self.window] = part
        return image


def _frame(frame: Frame, drawing: _Drawing) -> ConditionFrame:
    return ConditionFrame(
        frame,
        partial(drawing.whole, drawing.point_image, GREY),
        partial(drawing.whole, drawing.point_mask, False),
        partial(drawing.whole, drawing.reactive_mask, False),
    )


def _why_unseen(scene: Scene, insertion: Insertion) -> str:
    frames = scene.all_frames()
    positions = insertion.trajectory.at([frame.camera.time for frame in frames])[:, :3, 3]
    depths = np.array([f.camera.project(p[None])[1][0] for f, p in zip(frames, positions, strict=True)])
    where = "behind the camera" if (depths < 0).all() else "outside the image"
    nearest = int(np.argmax(depths))
    name = f"{len(scene.frames)} cameras" if len(scene.frames) > 1 else scene.main_camera
    return (
        f"the vehicle is {where} in every frame of {name} ({depths[nearest]:.1f} m ahead in frame "
        f"{frames[nearest].index}); move its trajectory into view, or choose other frames or cameras"
    )
