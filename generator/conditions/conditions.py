"""What a generator is told: where the vehicle's points fall, and where it may paint."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dwgs.scene import Frame, InputError, Insertion, Scene
from dwgs.scene.pose import transform_points
from dwgs.scene.silhouette import NEAR
from generator.conditions.masks import SHADOW_MARGIN, inactive_image, reactive_mask
from generator.conditions.projection import PointProjector
from generator.conditions.raster import GREY, PointRasterizer

PointStyle = Literal["discs", "pixels"]
"""``discs`` as in the paper, or one pixel for each point: its ablation."""

VISIBILITY_POINTS = 2000
"""So many points of a vehicle tell whether a camera sees it."""


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
    points: PointStyle = "discs",
) -> Conditions:
    """Draw the points and masks of an insertion for every frame of a scene.

    Args:
        scene: The recording.
        insertion: What to put where.
        on_progress: Called with (frames done, frames in all).
        shadow_margin: Ground around the vehicle that may be repainted [m].
        points: How they are drawn.

    Raises:
        InputError: The trajectory does not cover the clip, or no frame sees the vehicle.
    """
    require_visible(scene, insertion)
    frames = scene.all_frames()
    rasterizer = PointRasterizer(insertion.vehicle) if points == "discs" else PointProjector(insertion.vehicle)

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

    drawn = iter(drawings)
    conditions = {name: tuple(_frame(f, next(drawn)) for f in fs) for name, fs in scene.frames.items()}
    return Conditions(scene, insertion, conditions)


def require_visible(scene: Scene, insertion: Insertion) -> None:
    """Raise `InputError` unless the trajectory covers the clip and some frame has a point of the vehicle in it."""
    frames = scene.all_frames()
    insertion.trajectory.require(sorted({frame.camera.time for frame in frames}))
    points = insertion.vehicle.points[:: 1 + len(insertion.vehicle.points) // VISIBILITY_POINTS]
    farthest, index = -np.inf, frames[0].index
    for frame in frames:
        camera = frame.camera
        pixels, depths = camera.project(transform_points(insertion.trajectory.at(camera.time), points))
        if (camera.contains(pixels) & (depths > NEAR)).any():
            return
        if (depth := float(depths.mean())) > farthest:
            farthest, index = depth, frame.index
    where = "behind the camera" if farthest < 0 else "outside the image"
    name = f"{len(scene.frames)} cameras" if len(scene.frames) > 1 else scene.main_camera
    raise InputError(
        f"the vehicle is {where} in every frame of {name} ({farthest:.1f} m ahead in frame {index}); "
        "move its trajectory into view, or choose other frames or cameras"
    )


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
