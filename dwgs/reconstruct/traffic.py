"""The traffic while it is learnt: Gaussians in the frames of boxes that are moved a little in every frame."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from dwgs.optimize import PoseParameters
from dwgs.reconstruct.config import NEAREST, UNIT_DISTANCE
from dwgs.reconstruct.discs import discs, sh_of_color
from dwgs.reconstruct.thinning import VOXEL_PIXELS, thin
from dwgs.scene import Frame, Gaussians, Insertion, Trajectory, VehicleAsset
from dwgs.scene.moving import BODY_MARGIN, is_there
from dwgs.scene.pose import inverse, pose, transform_points

OPACITY, SHADOW_OPACITY = 0.8, 0.05
"""At the start."""
SHADOW_MARGIN = 1.0
"""How far around a box its shadow is looked for [m]."""
SHADOW_SPACING, SHADOW_PIXELS = 0.12, 4.0
"""The discs on the ground that darken it are as far apart as both say [m], [px]."""
SHADOW_LIFT, SHADOW_GREY = 0.04, 0.03
"""Of these discs: above the ground [m], and their colour."""
LARGEST = 0.2
"""Largest standard deviation on a body [m]: beyond it lies fog."""
ROTATION_RATE, TRANSLATION_RATE = 5e-4, 3e-3
"""Step sizes of a box [rad], [m]."""
MAX_ROTATION, MAX_TRANSLATION = 0.05, 0.4
"""How far a box may be turned about each axis [rad], and shifted along it [m]."""
ROTATION_SPREAD, TRANSLATION_SPREAD = 0.01, 0.1
"""How far annotated boxes usually are off [rad], [m]."""
PRIOR_WEIGHT = 1e-5
"""Of the squared corrections in these units, and of how they change from frame to frame."""
BEHIND = 1e3
"""What is not there stands so far behind the camera [m]."""


@dataclass(frozen=True)
class Actor:
    """Something that moves, as it was reconstructed."""

    id: str
    """Of its track."""
    asset: VehicleAsset
    """Body and shadow in the frame of the box."""
    trajectory: Trajectory
    """Of the box, refined."""


@dataclass(frozen=True)
class Group:
    """Gaussians that move as one."""

    owner: int
    """Number of the mover, -1 for the street."""
    count: int
    is_shadow: bool = False


class Traffic:
    """All that moves, K of them: how they begin, and the poses of their boxes in every frame.

    Args:
        movers: By id, where they drive and what is known of their surface.
        frames: Those that teach.
    """

    def __init__(self, movers: Mapping[str, Insertion], frames: list[Frame]) -> None:
        self.ids, self.movers, self.frames = list(movers), list(movers.values()), frames
        self._distances = [_nearest(mover, frames) for mover in self.movers]
        instants = sorted({frame.index for frame in frames})  # whose cameras share the corrections
        self._instants = [instants.index(frame.index) for frame in frames]
        self._times = np.array([np.mean([f.camera.time for f in frames if f.index == i]) for i in instants])
        self._poses = PoseParameters(len(movers) * len(instants), ROTATION_RATE, TRANSLATION_RATE)
        self._present = [
            [k for k, mover in enumerate(self.movers) if is_there(mover.trajectory, f.camera.time)] for f in frames
        ]
        self._recorded = [self._poses_in(frame, there) for frame, there in zip(frames, self._present, strict=True)]

    def begin(self) -> list[tuple[Group, Gaussians]]:
        """Bodies and shadows before the first step."""
        groups = []
        for k, mover in enumerate(self.movers):
            pixel = self._distances[k] / self.frames[0].camera.K[0, 0]
            body, shadow = _body(mover, VOXEL_PIXELS * pixel), _shadow(mover.size, SHADOW_PIXELS * pixel)
            groups += [(Group(k, len(body)), body), (Group(k, len(shadow), is_shadow=True), shadow)]
        return groups

    def step_scale(self, group: Group) -> Tensor:
        """Distance [N] of a group's Gaussians in `UNIT_DISTANCE`, 0 for shadows, which stay where they are."""
        return torch.full((group.count,), 0 if group.is_shadow else self._distances[group.owner] / UNIT_DISTANCE)

    def poses(self, i: int) -> Tensor:
        """``world_from_box`` [K, 4, 4] in frame ``i``; a gradient flows to its corrections."""
        present, poses = self._present[i], self._recorded[i]
        if present:
            corrected = poses[present] @ self._poses.matrices(self._numbers(present, self._instants[i]))
            poses = poses.index_copy(0, torch.tensor(present), corrected)
        return poses

    def prior(self, i: int) -> Tensor:
        """How unusual the corrections of frame ``i`` are: their squares, and those of their change in time."""
        total, j, last = torch.zeros(()), self._instants[i], len(self._times) - 1
        numbers, *around = (self._numbers(self._present[i], t) for t in (j, max(j - 1, 0), min(j + 1, last)))
        for values, spread in (
            (self._poses.rotations, ROTATION_SPREAD),
            (self._poses.translations, TRANSLATION_SPREAD),
        ):
            bend = values[numbers] - (values[around[0]] + values[around[1]]).detach() / 2
            total = total + ((values[numbers] / spread) ** 2).sum() + ((bend / spread) ** 2).sum()
        return PRIOR_WEIGHT * total

    def step(self, factor: float) -> None:
        """Move the boxes along the gradients, rates times ``factor``; the Gaussians step with the street."""
        self._poses.step(factor)
        with torch.no_grad():
            self._poses.rotations.clamp_(-MAX_ROTATION, MAX_ROTATION)
            self._poses.translations.clamp_(-MAX_TRANSLATION, MAX_TRANSLATION)

    def state_dict(self) -> dict[str, Any]:
        """Everything that further steps depend on."""
        return self._poses.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Be what `state_dict` gave."""
        self._poses.load_state_dict(state)

    def adopt(self, i: int, gaussians: Gaussians) -> list[tuple[Group, Gaussians]]:
        """Sort Gaussians that stand in the world in frame ``i`` by whose box they are in; the street's come first."""
        with torch.no_grad():
            poses = self.poses(i).double().numpy()
        owner, groups = np.full(len(gaussians), -1), []
        for k in self._present[i]:
            local = transform_points(inverse(poses[k]), gaussians.means)
            low, high = self.bounds(k)
            mine = (owner < 0) & ((local > low) & (local < high)).all(1)
            if mine.any():
                owner[mine] = k
                own = replace(gaussians[mine], means=local[mine].astype(np.float32))
                groups.append((Group(k, len(own)), own))
        return [(Group(-1, int((owner < 0).sum())), gaussians[owner < 0]), *groups]

    def bounds(self, k: int) -> NDArray[np.float64]:
        """[2, 3] lowest and highest corner of where a body may lie [m]: hardly in the ground."""
        half = np.asarray(self.movers[k].size, np.float64) / 2
        return np.array([-half - (BODY_MARGIN, BODY_MARGIN, 0.02), half + BODY_MARGIN])

    def to_actors(self, groups: list[tuple[Group, Gaussians]], provenance: dict) -> list[Actor]:
        """All of them, frozen, each with its own Gaussians."""
        actors = []
        for k, (id, mover) in enumerate(zip(self.ids, self.movers, strict=True)):
            clouds = [
                Gaussians.concatenate([cloud for g, cloud in groups if g.owner == k and g.is_shadow == is_shadow])
                for is_shadow in (False, True)
            ]
            body, shadow = (cloud[cloud.opacities >= 1 / 255] for cloud in clouds)
            size = np.asarray(mover.size, np.float64)
            rotation, translation = self._corrections(k)
            quality = {
                "pose_correction_rms_deg": round(float(np.degrees(rotation)), 4),
                "pose_correction_rms_m": round(translation, 5),
            }
            asset = VehicleAsset(body, shadow, size, mover.category, provenance, quality)
            actors.append(Actor(id, asset, self._refined(k, mover.trajectory)))
        return actors

    def _corrections(self, k: int) -> tuple[float, float]:
        """Root mean square of a box's rotations [rad] and of its translations [m]."""
        there = [k * len(self._times) + j for j in self._instants_of(k)]
        sizes = self._poses.rotations[there].norm(dim=1), self._poses.translations[there].norm(dim=1)
        rotation, translation = (float(size.detach().square().mean().sqrt()) for size in sizes)
        return rotation, translation

    def _refined(self, k: int, trajectory: Trajectory) -> Trajectory:
        """From frame to frame that taught, as it was put right there; before and after them as recorded.

        Annotation trembles by centimetres: between two frames a straight line knows better.
        """
        there = self._instants_of(k)
        numbers = [k * len(self._times) + j for j in there]
        six = torch.cat([self._poses.rotations, self._poses.translations], 1).detach().double()[numbers].numpy()
        taught, recorded = self._times[there], trajectory.times
        every = np.union1d(taught, recorded[(recorded < taught[0]) | (recorded > taught[-1])]).astype(np.float64)
        between = np.stack([np.interp(every, taught, six[:, axis]) for axis in range(6)], 1)
        skew = np.zeros((len(every), 3, 3))
        skew[:, [2, 0, 1], [1, 2, 0]] = between[:, :3]
        skew -= np.swapaxes(skew, 1, 2)
        rotation = torch.matrix_exp(torch.from_numpy(skew)).numpy()
        return Trajectory(every, trajectory.at(every) @ pose(rotation, between[:, 3:]))

    def _poses_in(self, frame: Frame, present: list[int]) -> Tensor:
        """``world_from_box`` [K, 4, 4] as recorded."""
        absent = frame.camera.world_from_camera.copy()
        absent[:3, 3] -= BEHIND * absent[:3, 2]
        poses = np.broadcast_to(absent, (len(self.movers), 4, 4)).copy()
        for k in present:
            poses[k] = self.movers[k].trajectory.at(frame.camera.time)
        return torch.from_numpy(poses).float()

    def _numbers(self, who: list[int], instant: int) -> list[int]:
        """Of the corrections of some of them at an instant."""
        return [k * len(self._times) + instant for k in who]

    def _instants_of(self, k: int) -> list[int]:
        """At which one of them is there."""
        return sorted({instant for instant, present in zip(self._instants, self._present, strict=True) if k in present})


def _body(mover: Insertion, size: float) -> Gaussians:
    """Discs on what is known of the surface, ``size`` [m] apart."""
    known = mover.vehicle.points.astype(np.float64)
    points, sizes = thin(known, np.full(len(known), size))
    if len(points) == 1:
        points, sizes = points + np.array([[0, 0, -0.01], [0, 0, 0.01]]), np.repeat(sizes, 2)
    colors = mover.vehicle.colors[KDTree(known).query(points)[1]] / 255
    return replace(discs(points, sizes, OPACITY), sh=sh_of_color(colors))


def _nearest(mover: Insertion, frames: list[Frame]) -> float:
    """How near a camera comes to the surface of a box [m], about; at least `NEAREST`."""
    cameras = [frame.camera for frame in frames if is_there(mover.trajectory, frame.camera.time)]
    distances = [np.linalg.norm(mover.trajectory.at(c.time)[:3, 3] - c.position) for c in cameras]
    return max(NEAREST, min(distances, default=NEAREST) - mover.size[0] / 2)


def _shadow(size: NDArray[np.float64], spacing: float) -> Gaussians:
    """Faint dark discs flat on the ground under a box and around it, ``spacing`` [m] apart or more."""
    spacing = max(spacing, SHADOW_SPACING)
    half = np.asarray(size, np.float64)[:2] / 2 + SHADOW_MARGIN
    x, y = (np.arange(spacing / 2 - h, h, spacing) for h in half)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    means = np.column_stack([grid, np.full(len(grid), SHADOW_LIFT - size[2] / 2)]).astype(np.float32)
    radius = 0.7 * spacing
    return Gaussians(
        means,
        np.tile(np.array([1, 0, 0, 0], np.float32), (len(means), 1)),
        np.tile(np.array([radius, radius, 0.01], np.float32), (len(means), 1)),
        np.full(len(means), SHADOW_OPACITY, np.float32),
        sh_of_color(np.full(means.shape, SHADOW_GREY)),
    )
