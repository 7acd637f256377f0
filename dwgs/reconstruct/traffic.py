"""The traffic while it is learnt: Gaussians in the frames of boxes that are moved a little in every frame."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from dwgs.optimize import PoseParameters, SplatParameters
from dwgs.reconstruct.config import RATES
from dwgs.reconstruct.discs import discs, sh_of_color
from dwgs.reconstruct.moving_mask import BODY_MARGIN, is_there
from dwgs.reconstruct.thinning import VOXEL_PIXELS, thin
from dwgs.scene import Frame, Gaussians, Insertion, Track, Trajectory, VehicleAsset
from dwgs.scene.pose import inverse, pose, transform_points

OPACITY, SHADOW_OPACITY = 0.8, 0.05
"""At the start."""
SHADOW_MARGIN = 1.0
"""How far around a box its shadow is looked for [m]."""
SHADOW_SPACING, SHADOW_LIFT, SHADOW_GREY = 0.12, 0.04, 0.03
"""Of the discs on the ground that darken it: between them and above the ground [m], and their colour."""
LARGEST = 0.15
"""Largest standard deviation on a body [m]; farther away, where a pixel is larger, a pixel."""
ROTATION_RATE, TRANSLATION_RATE = 2e-4, 1e-3
"""Step sizes of a box [rad], [m]."""
MAX_ROTATION, MAX_TRANSLATION = 0.05, 0.4
"""How far a box may be turned about each axis [rad], and shifted along it [m]."""
ROTATION_SPREAD, TRANSLATION_SPREAD = 0.01, 0.1
"""How far annotated boxes usually are off [rad], [m]."""
PRIOR_WEIGHT = 1e-5
"""Of the squared corrections in these units, and of how they change from frame to frame."""
BEHIND = 1e3
"""Whoever is not there stands so far behind the camera [m]."""
UNIT_DISTANCE, NEAREST = 10.0, 3.0
"""The rate of the means holds at this distance from the nearest camera [m], see `Street`; none is nearer."""


@dataclass(frozen=True)
class Actor:
    """Somebody recorded, as he was reconstructed."""

    track: Track
    """With the poses that were refined."""
    asset: VehicleAsset
    """Body and shadow in the frame of the box."""


class Traffic:
    """Everybody who moves, K of them: bodies, shadows, and the poses of their boxes in every frame.

    Args:
        movers: By id, where they drive and what is known of their surface.
        frames: Those that teach.
    """

    def __init__(self, movers: Mapping[str, Insertion], frames: list[Frame]) -> None:
        self.movers, self.frames = dict(movers), frames
        instants = sorted({frame.index for frame in frames})  # whose cameras share the corrections
        self._instants = [instants.index(frame.index) for frame in frames]
        self._times = np.array([np.mean([f.camera.time for f in frames if f.index == i]) for i in instants])
        self._distances = [_nearest(mover, frames) for mover in movers.values()]
        focal = frames[0].camera.K[0, 0]
        self._pixels = [distance / focal for distance in self._distances]
        self.bodies = [self._body(k, mover) for k, mover in enumerate(movers.values())]
        shadows = [_shadow(mover.size) for mover in movers.values()]
        self._shadow_counts = [len(shadow) for shadow in shadows]
        still = replace(RATES, means=0.0)
        self.shadows = SplatParameters(Gaussians.concatenate(shadows), still) if shadows else None
        self._poses = PoseParameters(len(self.movers) * len(self._times), ROTATION_RATE, TRANSLATION_RATE)
        self._present = [
            [k for k, m in enumerate(self.movers.values()) if is_there(m.trajectory, f.camera.time)] for f in frames
        ]

    def __len__(self) -> int:
        return len(self.movers)

    @property
    def parts(self) -> list[SplatParameters]:
        """Bodies one by one, then all shadows."""
        return [*self.bodies, *([] if self.shadows is None else [self.shadows])]

    @property
    def counts(self) -> tuple[int, ...]:
        """[2K] Gaussians of each body, then of each shadow."""
        return (*map(len, self.bodies), *self._shadow_counts)

    def poses(self, i: int) -> Tensor:
        """``world_from_box`` [2K, 4, 4] of bodies and shadows in frame ``i``; a gradient flows to its corrections."""
        present, camera = self._present[i], self.frames[i].camera
        absent = camera.world_from_camera.copy()
        absent[:3, 3] -= BEHIND * absent[:3, 2]
        known = np.broadcast_to(absent, (len(self), 4, 4)).copy()
        for k in present:
            known[k] = list(self.movers.values())[k].trajectory.at(camera.time)
        poses = torch.from_numpy(known).float()
        if present:
            corrected = poses[present] @ self._poses.matrices(self._numbers(present, self._instants[i]))
            poses = poses.index_copy(0, torch.tensor(present), corrected)
        return torch.cat([poses, poses])

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
        """Move the boxes along the gradients; the Gaussians step with the street."""
        self._poses.step(factor)
        with torch.no_grad():
            self._poses.rotations.clamp_(-MAX_ROTATION, MAX_ROTATION)
            self._poses.translations.clamp_(-MAX_TRANSLATION, MAX_TRANSLATION)

    def adopt(self, i: int, gaussians: Gaussians) -> Gaussians:
        """Take those that lie in somebody's box in frame ``i``; gives the others back."""
        with torch.no_grad():
            poses = self.poses(i).double().numpy()
        free = np.ones(len(gaussians), bool)
        for k in self._present[i]:
            local = transform_points(inverse(poses[k]), gaussians.means)
            low, high = self._bounds(k)
            mine = free & ((local > low) & (local < high)).all(1)
            if mine.any():
                own = replace(gaussians[mine], means=local[mine].astype(np.float32))
                self.bodies[k].append(own, torch.full((len(own),), self._stride(k)))
            free &= ~mine
        return gaussians[free]

    def to_actors(self, provenance: dict) -> list[Actor]:
        """Everybody, frozen."""
        actors = []
        shadows = self.shadows.to_gaussians() if self.shadows is not None else Gaussians.empty(1)
        ends = np.cumsum(self._shadow_counts)
        for k, (id, mover) in enumerate(self.movers.items()):
            body, shadow = self.bodies[k].to_gaussians(), shadows[ends[k] - self._shadow_counts[k] : ends[k]]
            clouds = (cloud[cloud.opacities >= 1 / 255] for cloud in (body, shadow))
            asset = VehicleAsset(*clouds, np.asarray(mover.size), mover.category, provenance)
            track = Track(id, mover.category, np.asarray(mover.size), self._refined(k, mover.trajectory), True)
            actors.append(Actor(track, asset))
        return actors

    def corrections(self, k: int) -> tuple[float, float]:
        """Root mean square of a box's rotations [rad] and of its translations [m]."""
        there = [k * len(self._times) + j for j in self._instants_of(k)]
        sizes = self._poses.rotations[there].norm(dim=1), self._poses.translations[there].norm(dim=1)
        rotation, translation = (float(size.detach().square().mean().sqrt()) for size in sizes)
        return rotation, translation

    def _refined(self, k: int, trajectory: Trajectory) -> Trajectory:
        """The recorded motion with the corrections of the frames, and between them, linearly."""
        there = self._instants_of(k)
        numbers = [k * len(self._times) + j for j in there]
        six = torch.cat([self._poses.rotations, self._poses.translations], 1).detach().double()[numbers].numpy()
        every = np.unique(np.concatenate([trajectory.times, self._times[there]]))
        between = np.stack([np.interp(every, self._times[there], six[:, axis]) for axis in range(6)], 1)
        skew = np.zeros((len(every), 3, 3))
        skew[:, [2, 0, 1], [1, 2, 0]] = between[:, :3]
        skew -= np.swapaxes(skew, 1, 2)
        rotation = torch.matrix_exp(torch.from_numpy(skew)).numpy()
        return Trajectory(every, trajectory.at(every) @ pose(rotation, between[:, 3:]))

    def _numbers(self, who: list[int], instant: int) -> list[int]:
        """Of the corrections of some of them at an instant."""
        return [k * len(self._times) + instant for k in who]

    def _instants_of(self, k: int) -> list[int]:
        """At which somebody is there."""
        return sorted({instant for instant, present in zip(self._instants, self._present, strict=True) if k in present})

    def _stride(self, k: int) -> float:
        return self._distances[k] / UNIT_DISTANCE

    def _bounds(self, k: int) -> NDArray[np.float64]:
        """[2, 3] lowest and highest corner of where a body may lie [m]: hardly in the ground."""
        half = np.asarray(list(self.movers.values())[k].size, np.float64) / 2
        return np.array([-half - (BODY_MARGIN, BODY_MARGIN, 0.02), half + BODY_MARGIN])

    def _body(self, k: int, mover: Insertion) -> SplatParameters:
        """Discs on what is known of the surface, as dense as the nearest image resolves."""
        size = VOXEL_PIXELS * self._pixels[k]
        known = mover.vehicle.points.astype(np.float64)
        points, sizes = thin(known, np.full(len(known), size))
        if len(points) == 1:
            points, sizes = np.repeat(points, 2, 0) + [[0, 0, -0.01], [0, 0, 0.01]], np.repeat(sizes, 2)
        colors = mover.vehicle.colors[KDTree(known).query(points)[1]] / 255
        gaussians = replace(discs(points, sizes, OPACITY), sh=sh_of_color(colors))
        largest = float(max(LARGEST, 2 * self._pixels[k]))
        strides = torch.full((len(gaussians),), self._stride(k))
        return SplatParameters(gaussians, RATES, strides, self._bounds(k), (largest,) * 3)


def _nearest(mover: Insertion, frames: list[Frame]) -> float:
    """How near a camera comes to the surface of a box [m], about; at least `NEAREST`."""
    cameras = [frame.camera for frame in frames if is_there(mover.trajectory, frame.camera.time)]
    distances = [np.linalg.norm(mover.trajectory.at(c.time)[:3, 3] - c.position) for c in cameras]
    return max(NEAREST, min(distances, default=NEAREST) - mover.size[0] / 2)


def _shadow(size: NDArray[np.float64]) -> Gaussians:
    """Faint dark discs flat on the ground under a box and around it."""
    half = np.asarray(size, np.float64)[:2] / 2 + SHADOW_MARGIN
    x, y = (np.arange(SHADOW_SPACING / 2 - h, h, SHADOW_SPACING) for h in half)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    means = np.column_stack([grid, np.full(len(grid), SHADOW_LIFT - size[2] / 2)]).astype(np.float32)
    radius = 0.7 * SHADOW_SPACING
    return Gaussians(
        means,
        np.tile(np.float32([1, 0, 0, 0]), (len(means), 1)),
        np.tile(np.float32([radius, radius, 0.01]), (len(means), 1)),
        np.full(len(means), SHADOW_OPACITY, np.float32),
        sh_of_color(np.full(means.shape, SHADOW_GREY)),
    )
