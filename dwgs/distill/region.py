"""Where in a frame the vehicle may be learnt."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_fill_holes, distance_transform_edt

from dwgs.scene import Camera, Frame, Insertion, Track, Trajectory
from dwgs.scene.insertion import box_corners
from dwgs.scene.pose import transform_points
from dwgs.scene.silhouette import NEAR, box_silhouette

MARGIN = 8
"""Pixels around a reactive mask, or the box of a recorded car, that are compared too."""
APRON = 16
"""Pixels of the window around the region: nothing of the vehicle may leak there."""
DENSE = 50_000
"""So many of the vehicle's points tell what it covers: more would only fall into the same pixels."""
GAP = 4
"""Points of the vehicle twice as far apart as this [px] still cover what lies between them."""
SAMPLES = 5000
"""About so many points say how much of the vehicle is in the image."""


@dataclass(frozen=True)
class Window:
    """A rectangle of an image [px]."""

    x: int
    y: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """What takes the part inside out of anything [H, W, ...]."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    def of(self, image: NDArray) -> NDArray:
        """The part of an image [H, W, ...] inside."""
        return image[self.slices]

    def camera(self, camera: Camera) -> Camera:
        """The camera that sees only this part."""
        return camera.crop(self.x, self.y, self.width, self.height)


@dataclass(frozen=True)
class Region:
    """The part of one frame that is compared, cut to the window around it."""

    window: Window
    """Encloses the supervised pixels."""
    supervised: NDArray[np.bool_]
    """[h, w] pixels that are compared with the frame."""
    bare: NDArray[np.bool_]
    """[h, w] pixels where nothing of the vehicle may show: outside the reactive mask, or far from the box."""
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

    Pixels of traffic that the frozen background does not hold teach nothing: where it reaches nearer than
    the vehicle's centre all are left out, farther away those that the vehicle does not cover.
    A recording holds the vehicle itself too, once per sensor: boxes centred in its own are no traffic.

    Args:
        frame: With or without a reactive mask.
        camera: Through which the vehicle is seen.
        world_from_vehicle: [4, 4] at the frame's time.
        insertion: The vehicle.
        tracks: Of the recording, but for what the frozen background holds.
    """
    reactive = frame.reactive_mask
    if reactive is None:
        own = [(world_from_vehicle, insertion.size)]
        tracks = [track for track in tracks if not is_inside(track.trajectory, camera.time, own)]
        supervised = box_silhouette(camera, world_from_vehicle, insertion.size, MARGIN)
        reactive = np.zeros_like(supervised)
    else:
        supervised = _dilated(reactive, MARGIN)
    if not supervised.any():
        return None
    window = window_around(supervised, APRON)
    supervised, reactive = window.of(supervised).copy(), window.of(reactive).copy()  # the image need not stay
    bare = ~reactive if reactive.any() else ~supervised
    inside = window.camera(camera)
    own_depth = camera.project(world_from_vehicle[None, :3, 3])[1][0]
    traffic = [(other, depth) for other, depth in _traffic(inside, tracks) if (other & supervised).any()]
    for other, _ in (pair for pair in traffic if pair[1] < own_depth):
        supervised = supervised & ~other
    farther = [other for other, depth in traffic if depth >= own_depth]
    if farther:
        supervised = supervised & (covered(inside, world_from_vehicle, insertion) | ~np.logical_or.reduce(farther))
    return Region(window, supervised, bare, reactive) if supervised.any() else None


def visible_fraction(camera: Camera, world_from_vehicle: NDArray[np.float64], insertion: Insertion) -> float:
    """Which part of the vehicle's points falls into the image, whatever stands before them."""
    points = insertion.vehicle.points
    points = points[:: len(points) // SAMPLES + 1]
    pixels, depth = camera.project(transform_points(world_from_vehicle, points))
    return float((camera.contains(pixels) & (depth > NEAR)).mean())


def is_inside(trajectory: Trajectory, time: float, boxes: Sequence[tuple[NDArray[np.float64], NDArray]]) -> bool:
    """Whether a centre that moves along ``trajectory`` lies in any of the ``boxes`` at a ``time`` [s].

    Two vehicles that drive so are one. A box is its ``world_from_box`` [4, 4] and its size [3].
    """
    if not boxes or not trajectory.covers(time):
        return False
    centre = trajectory.at(time)[:3, 3]
    return any(
        bool((np.abs((centre - world_from_box[:3, 3]) @ world_from_box[:3, :3]) < np.asarray(size) / 2).all())
        for world_from_box, size in boxes
    )


def covered(camera: Camera, world_from_vehicle: NDArray, insertion: Insertion) -> NDArray[np.bool_]:
    """Pixels [h, w] that the vehicle's points cover, gaps between them closed."""
    points = insertion.vehicle.points
    pixels, depth = camera.project(transform_points(world_from_vehicle, points[:: len(points) // DENSE + 1]))
    column, row = np.floor(pixels[camera.contains(pixels) & (depth > NEAR)]).astype(int).T
    hit = np.zeros((camera.height, camera.width), bool)
    hit[row, column] = True
    if hit.any():
        part = window_around(hit, 0).of(hit)
        part[:] = binary_fill_holes(binary_closing(np.pad(part, GAP), iterations=GAP))[GAP:-GAP, GAP:-GAP]
    return hit


def _traffic(camera: Camera, tracks: Sequence[Track]) -> Iterator[tuple[NDArray[np.bool_], float]]:
    """Silhouettes [h, w] of boxes on the move, widened, with the depth [m] of their nearest corner."""
    for track in tracks:
        if not track.is_moving or not track.trajectory.covers(camera.time):
            continue
        world_from_other = track.trajectory.at(camera.time)
        pixels, depth = camera.project(transform_points(world_from_other, box_corners(track.size)))
        if depth.max() < NEAR:
            continue
        if depth.min() > NEAR:
            low, high = pixels.min(0) - MARGIN, pixels.max(0) + MARGIN
            if (high < 0).any() or (low > (camera.width, camera.height)).any():
                continue
        yield box_silhouette(camera, world_from_other, track.size, MARGIN), depth.min()


def _dilated(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    if not mask.any():
        return mask
    window = window_around(mask, int(radius) + 1)
    dilated = np.zeros_like(mask)
    window.of(dilated)[:] = np.asarray(distance_transform_edt(~window.of(mask))) <= radius
    return dilated


def window_around(mask: NDArray[np.bool_], apron: int) -> Window:
    """The smallest that holds a mask with an ``apron`` [px] around it."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    top, bottom = max(rows[0] - apron, 0), min(rows[-1] + 1 + apron, mask.shape[0])
    left, right = max(columns[0] - apron, 0), min(columns[-1] + 1 + apron, mask.shape[1])
    return Window(int(left), int(top), int(right - left), int(bottom - top))
