"""Where in a frame the vehicle may be learnt."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from dwgs.scene import Camera, Frame, Insertion, Track
from dwgs.scene.pose import inverse, transform_points
from dwgs.scene.silhouette import NEAR, box_silhouette

MARGIN = 8
"""Pixels around a reactive mask, or the box of a recorded car, that are supervised too: they stop leaks."""
APRON = 6
"""Pixels of the window around the region, so that an 11 px SSIM window at its rim sees an image."""
SAMPLES = 5000
"""About so many points say how much of the vehicle is in the image."""


@dataclass(frozen=True)
class Window:
    """A rectangle of an image [px]."""

    x: int
    y: int
    width: int
    height: int

    def of(self, image: NDArray) -> NDArray:
        """The part of an image [H, W, ...] inside."""
        return image[self.y : self.y + self.height, self.x : self.x + self.width]

    def camera(self, camera: Camera) -> Camera:
        """The camera that sees only this part."""
        return camera.crop(self.x, self.y, self.width, self.height)


@dataclass(frozen=True)
class Region:
    """The part of one frame that is compared, cut to the window around it."""

    window: Window
    """Encloses the supervised pixels."""
    supervised: NDArray[np.bool_]
    """[h, w] pixels that teach and are scored."""
    reactive: NDArray[np.bool_]
    """[h, w] pixels that a generator may have repainted; all False in a recorded frame."""


def find_region(
    frame: Frame,
    camera: Camera,
    world_from_vehicle: NDArray[np.float64],
    insertion: Insertion,
    tracks: Sequence[Track],
) -> Region | None:
    """Of a frame: its reactive mask, or the box of a recorded car, widened; None where nothing is left.

    Pixels of other traffic teach nothing, for the frozen background does not hold it: before the vehicle's
    box they are left out wherever they are, behind it wherever the box does not cover them.

    Args:
        frame: With or without a reactive mask.
        camera: Through which the vehicle is seen.
        world_from_vehicle: [4, 4] at the frame's time.
        insertion: Size of the box, and which recorded track is the vehicle itself.
        tracks: Of the recording.
    """
    size = insertion.size
    reactive = frame.reactive_mask
    if reactive is None:
        supervised = box_silhouette(camera, world_from_vehicle, size, MARGIN)
        reactive = np.zeros_like(supervised)
    else:
        supervised = _dilated(reactive, MARGIN)
    if not supervised.any():
        return None
    window = _window_around(supervised, APRON)
    supervised, reactive = window.of(supervised), window.of(reactive)
    inside = window.camera(camera)
    silhouette = box_silhouette(inside, world_from_vehicle, size)
    for other, is_nearer in _other_traffic(inside, world_from_vehicle, insertion, tracks):
        supervised = supervised & (~other if is_nearer else ~other | silhouette)
    return Region(window, supervised, reactive) if supervised.any() else None


def visible_fraction(camera: Camera, world_from_vehicle: NDArray[np.float64], insertion: Insertion) -> float:
    """Which part of the vehicle's points falls into the image, whatever stands before them."""
    points = insertion.vehicle.points
    points = points[:: len(points) // SAMPLES + 1]
    pixels, depth = camera.project(transform_points(world_from_vehicle, points))
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0).all(1) & (pixels < (camera.width, camera.height)).all(1)
    return float((inside & (depth > NEAR)).mean())


def _other_traffic(camera, world_from_vehicle, insertion, tracks):
    """Silhouettes of recorded boxes on the move, and whether each is nearer than the vehicle.

    A box whose centre lies inside the vehicle's is the vehicle: recordings may hold it once per sensor.
    """
    vehicle_from_world = inverse(world_from_vehicle)
    own_depth = camera.project(world_from_vehicle[None, :3, 3])[1][0]
    for track in tracks:
        if not track.is_moving or not track.trajectory.covers(camera.time):
            continue
        world_from_other = track.trajectory.at(camera.time)
        is_own = np.abs((vehicle_from_world @ world_from_other)[:3, 3]) < insertion.size / 2
        pixel, depth = (values[0] for values in camera.project(world_from_other[None, :3, 3]))
        radius = np.linalg.norm(track.size) / 2
        reach = camera.K[0, 0] * radius / (depth - radius) + MARGIN if depth > radius else np.inf
        misses = (
            depth < -radius
            or (pixel < -reach).any()
            or (pixel > np.array([camera.width, camera.height]) + reach).any()
        )
        if not (is_own.all() or misses):
            yield box_silhouette(camera, world_from_other, track.size, MARGIN), depth < own_depth


def _dilated(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    if not mask.any():
        return mask
    window = _window_around(mask, int(radius) + 1)
    dilated = np.zeros_like(mask)
    window.of(dilated)[:] = np.asarray(distance_transform_edt(~window.of(mask))) <= radius
    return dilated


def _window_around(mask: NDArray[np.bool_], apron: int) -> Window:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    top, bottom = max(rows[0] - apron, 0), min(rows[-1] + 1 + apron, mask.shape[0])
    left, right = max(columns[0] - apron, 0), min(columns[-1] + 1 + apron, mask.shape[1])
    return Window(int(left), int(top), int(right - left), int(bottom - top))
