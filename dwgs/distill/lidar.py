"""LiDAR depths that a vehicle must agree with.

Inside a reactive mask the sweep shows the street as it was *before* the vehicle: nothing there is ever used.
Outside it says where the street is, and that the vehicle is not before it; of a recorded car it says where
its surface is. There is no sky term at all: the sky is part of the frozen background and cannot be learnt.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, from_numpy

from dwgs.distill.region import Region
from dwgs.scene import Camera, Insertion, LidarSweep
from dwgs.scene.pose import inverse
from dwgs.scene.silhouette import NEAR
from dwgs.splat import Drawing

MOST = 0.5
"""A relative difference beyond this says no more than that it is large."""
BOX_MARGIN = 0.1
"""A return this far outside the box [m] still belongs to the car."""


@dataclass(frozen=True)
class LidarDepths:
    """Measured depths at some pixels of a window."""

    rows: Tensor
    """[M] of the window; no pixel twice."""
    columns: Tensor
    """[M]."""
    depths: Tensor
    """[M] along the optical axis [m]."""

    is_bound: bool
    """Whether nothing may be nearer, rather than everything as near: the frozen street's own depth is not at
    issue, and a vehicle must not bend it."""

    def pull(self, drawing: Drawing, weight: float) -> float:
        """Mean relative difference of the drawn depth where something is drawn, times ``weight``.

        Adds its gradient to the drawing's.
        """
        depth, alpha = drawing.depth[self.rows, self.columns], drawing.alpha[self.rows, self.columns]
        alpha = alpha.clamp_min(1e-10)
        mean = depth / alpha
        error = (self.depths - mean) / self.depths
        size = error.clamp_min(0) if self.is_bound else error.abs()
        slope = torch.where(size < MOST, -weight / len(size) * size.sign() * error.sign() / self.depths, 0) / alpha
        drawing.v_depth[self.rows, self.columns] += slope
        drawing.v_alpha[self.rows, self.columns] -= slope * mean
        return weight * size.clamp_max(MOST).mean().item()


def static_depths(sweep: LidarSweep, camera: Camera, region: Region) -> LidarDepths | None:
    """What the sweep says in the supervised rim around a reactive mask; None where it says nothing.

    Args:
        sweep: Of the same instant.
        camera: Of the whole image.
        region: Of the same frame.
    """
    return _in_window(sweep.points, camera, region, is_bound=True)


def carried_depths(
    sweep: LidarSweep, camera: Camera, world_from_vehicle: NDArray, insertion: Insertion, region: Region
) -> LidarDepths | None:
    """The returns on a recorded car, each carried by the car from its own time to the camera's."""
    covered = insertion.trajectory.covers(sweep.times)
    points, times = sweep.points[covered], sweep.times[covered]
    reach = np.linalg.norm(insertion.size) + insertion.trajectory.length
    near = np.linalg.norm(points - world_from_vehicle[:3, 3], axis=1) < reach
    points, times = points[near], times[near]
    vehicle_from_world = inverse(insertion.trajectory.at(times))
    in_vehicle = np.einsum("nij,nj->ni", vehicle_from_world[:, :3, :3], points) + vehicle_from_world[:, :3, 3]
    on_car = (np.abs(in_vehicle) < insertion.size / 2 + BOX_MARGIN).all(1)
    moved = in_vehicle[on_car] @ world_from_vehicle[:3, :3].T + world_from_vehicle[:3, 3]
    return _in_window(moved, camera, region, is_bound=False)


def _in_window(points: NDArray, camera: Camera, region: Region, is_bound: bool) -> LidarDepths | None:
    """Nearest depth per pixel of the window, where it is supervised and not reactive."""
    window = region.window
    camera = window.camera(camera)
    pixels, depth = camera.project(points[camera.may_see(points)])
    inside = (depth > NEAR) & camera.contains(pixels)
    column, row = pixels[inside].astype(int).T
    depth = depth[inside]
    allowed = (region.supervised & ~region.reactive)[row, column]
    flat, depth = (row * window.width + column)[allowed], depth[allowed]
    if len(flat) == 0:
        return None
    order = np.lexsort((depth, flat))
    unique, first = np.unique(flat[order], return_index=True)
    rows, columns = (from_numpy(index) for index in np.divmod(unique, window.width))
    return LidarDepths(rows, columns, from_numpy(depth[order][first].astype(np.float32)), is_bound)
