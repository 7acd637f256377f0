"""Other vehicles on their ways, frozen as the street is: what is seen of them over a roof is explained, not masked."""

from collections.abc import Sequence

import torch
from torch import Tensor

from dwgs.distill.region import is_inside
from dwgs.scene import Camera, Insertion, Track, Trajectory, VehicleAsset
from dwgs.splat import Splats, View, project

Driven = tuple[VehicleAsset, Trajectory]
"""A vehicle, and where it drives."""


class Traffic:
    """Vehicles as the splatter wants them. Nothing is written to them."""

    def __init__(self, vehicles: Sequence[Driven] = ()) -> None:
        self.vehicles = tuple(vehicles)

    def records(self, camera: Camera) -> list[Tensor]:
        """[N, 16] projected records of what the camera sees of each vehicle that is there at its time."""
        seen = []
        for asset, trajectory in self.vehicles:
            if trajectory.covers(camera.time):
                world_from_vehicle = trajectory.at(camera.time)
                view = View.from_camera(camera, world_from_vehicle)
                for part in (asset.shadow_at(world_from_vehicle), *asset.parts_at(trajectory, camera.time)):
                    with torch.no_grad():
                        projected = project(Splats.from_gaussians(part), view, threads=1)
                    seen.append(projected[projected.visible].records)
        return seen

    def unexplained(self, tracks: Sequence[Track], time: float) -> list[Track]:
        """The recorded vehicles that are not among these at a ``time`` [s]: their centres lie in none's box."""
        boxes = [(path.at(time), asset.size) for asset, path in self.vehicles if path.covers(time)]
        return [track for track in tracks if not is_inside(track.trajectory, time, boxes)]


def others(vehicles: Sequence[Driven], insertion: Insertion) -> list[Driven]:
    """Those that are not the inserted vehicle itself: none of its kind drives with its centre in another's box."""

    def is_other(trajectory: Trajectory) -> bool:
        shared = trajectory.times[insertion.trajectory.covers(trajectory.times)]
        return not any(is_inside(trajectory, t, [(insertion.trajectory.at(t), insertion.size)]) for t in shared)

    return [(asset, trajectory) for asset, trajectory in vehicles if is_other(trajectory)]
