"""Where the vehicle really stands in every frame: small corrections that the images ask for and a vehicle could drive.

Annotated boxes are off by centimetres, and so are trajectories that people or networks made up. Each frame says where
the vehicle should go: by the gradient of its loss, and by how much its picture changes as the vehicle moves (Gauss-
Newton, Lucas and Kanade 1981). All frames are settled together, on a path that a vehicle may have driven.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dwgs.distill.config import Recipe
from dwgs.distill.path import Path, apart, moved
from dwgs.distill.shots import Shot, Sight
from dwgs.scene import Trajectory
from dwgs.scene.pose import inverse, pose
from dwgs.splat import Splats, render

MOST = np.repeat((0.05, 0.2), 3)
"""How far [rad, m] a pose may be corrected about or along each axis: the layers of the background allow for more."""
REFRESH = 4
"""Looks at a sight after which it is found out anew how its picture depends on the pose."""
UNDERRATED = 2
"""Differences between neighbours halve the square of what changes from pixel to pixel."""
LEAST_LOSS = 1e-6
"""A picture without error is not infinitely sure of its pose."""
FAINT = 0.02
"""Vehicle's alpha below which a pixel tells nothing about its pose."""

_STATE = ("_world_from_vehicle", "_information", "_pull", "_sensitivity", "_looks")


class BoxPoses:
    """Corrected poses of the vehicle, one per sight, about the box centre and along the axes of the world.

    Args:
        sights: Frames that show it, camera by camera, in order of time.
        recipe: What is known of such paths; whether losses are absolute errors, as if they were Laplace's, or squared
            ones, Gauss's.
        threads: That draw one picture.
    """

    def __init__(self, sights: Sequence[Sight], recipe: Recipe, threads: int = 2) -> None:
        self._recipe, self._threads = recipe, threads
        self._times = np.array([sight.frame.camera.time for sight in sights])
        self._nominal = np.array([sight.world_from_vehicle for sight in sights])
        self._world_from_camera = np.array([sight.camera.world_from_camera for sight in sights])
        self._world_from_vehicle = self._nominal.copy()
        cameras = [sight.frame.camera_name for sight in sights]
        self._path = Path(self._times, cameras, self._nominal, recipe.path)
        self._looks = np.zeros(len(sights), int)
        self._sensitivity, self._information = np.zeros((2, len(sights), 6, 6))
        self._pull = np.zeros((len(sights), 6))

    def is_rough(self) -> bool:
        """Whether the path trembles as no vehicle does: to and fro, where one that bends sharply goes on bending."""
        return self._path.is_rough()

    def old_from_new(self, i: int) -> NDArray[np.float64]:
        """[4, 4] the correction of a sight: ``world_from_new = world_from_old @ old_from_new``."""
        return inverse(self._nominal[i]) @ self._world_from_vehicle[i]

    def corrections(self) -> NDArray[np.float64]:
        """[sights, 6] rotation vectors [rad] and shifts [m] in the world."""
        return apart(self._world_from_vehicle, self._nominal)

    def refined(self, trajectory: Trajectory) -> Trajectory:
        """The trajectory with these corrections, at its own times and at those of the sights.

        Before the first sight and after the last their corrections stay as they are.
        """
        moments, at = np.unique(self._times, return_inverse=True)
        sums = np.zeros((len(moments), 6))
        np.add.at(sums, at, self.corrections())
        corrections = sums / np.bincount(at)[:, None]  # cameras that saw it at the same moment agree on their mean
        times = np.union1d(trajectory.times, moments)
        turn_shift = np.stack([np.interp(times, moments, axis) for axis in corrections.T], 1)
        poses = trajectory.at(times)
        turned = Rotation.from_rotvec(turn_shift[:, :3]).as_matrix() @ poses[:, :3, :3]
        return Trajectory(times, pose(turned, poses[:, :3, 3] + turn_shift[:, 3:]))

    def report(self) -> dict[str, float]:
        """JSON values: how far poses were corrected."""
        squares = self.corrections().reshape(-1, 2, 3) ** 2
        turns, shifts = np.sqrt(squares.sum(-1)).T
        return {
            "pose_correction_rms_m": round(float(np.sqrt((shifts**2).mean())), 4),
            "pose_correction_most_m": round(float(shifts.max()), 4),
            "pose_correction_rms_deg": round(float(np.degrees(np.sqrt((turns**2).mean()))), 3),
            "pose_correction_most_deg": round(float(np.degrees(turns.max())), 3),
        }

    def observe(self, i: int, shot: Shot, vehicle: Splats, loss: float, v_viewmat: NDArray[np.float64]) -> None:
        """Take in what the picture of a sight says.

        Args:
            i: Which.
            shot: The same, ready for the loop.
            vehicle: As it is now.
            loss: Mean error of the picture, squared or (if robust) absolute.
            v_viewmat: [4, 4] gradient of the loss by ``camera_from_vehicle``.
        """
        if self._looks[i] % REFRESH == 0:
            self._sensitivity[i] = sensitivity(shot, vehicle, self._world_from_vehicle[i], self._threads)
        self._looks[i] += 1
        numbers, loss = 3 * float(shot.weight.sum()), max(loss, LEAST_LOSS)
        # minus the logarithm of the likelihood, per loss, and its second derivative by the numbers of the picture
        share, curvature = (1 / loss, 1 / loss**2) if self._recipe.robust else (1 / (2 * loss), 1 / loss)
        from_camera = self._world_from_camera[i, :3, :3]
        turning = from_camera @ v_viewmat[:3, :3] @ self._world_from_vehicle[i, :3, :3].T
        torque = turning[[2, 0, 1], [1, 2, 0]] - turning[[1, 2, 0], [2, 0, 1]]
        force, coherence = from_camera @ v_viewmat[:3, 3], self._recipe.path.coherence
        self._information[i] = self._sensitivity[i] * (curvature / coherence)
        self._pull[i] = np.hstack([torque, force]) * (numbers * share / coherence)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Everything that further corrections depend on."""
        return {name: torch.from_numpy(getattr(self, name)) for name in _STATE}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Be what `state_dict` gave."""
        for name in _STATE:
            setattr(self, name, state[name].numpy())

    def settle(self) -> None:
        """Move every pose to where all that was observed, a smooth path, and small corrections agree best."""
        corrections = self.corrections()
        moves = self._path.moves(self._world_from_vehicle, self._information, self._pull)
        moves = np.clip(corrections + moves, -MOST, MOST) - corrections
        self._world_from_vehicle = moved(self._world_from_vehicle, moves)
        self._pull += np.einsum("nij,nj->ni", self._information, moves)


def sensitivity(
    shot: Shot, vehicle: Splats, world_from_vehicle: NDArray[np.float64], threads: int
) -> NDArray[np.float64]:
    """[6, 6] how strongly the picture depends on the pose: sums over pixels and colours of products of derivatives.

    A pixel of the vehicle moves as its point at that depth does, and takes along what the image changes there, the
    background apart, which stays.
    """
    camera = shot.sight.camera
    camera_from_vehicle = camera.camera_from_world @ world_from_vehicle
    view = shot.view_at(inverse(shot.sight.world_from_vehicle) @ world_from_vehicle)
    with torch.no_grad():
        alone = render(vehicle, view, threads=threads)
    back = shot.frozen.layers.back_rgb
    slopes = [torch.gradient(image, dim=(0, 1)) for image in (alone.rgb, alone.alpha)]
    by_y, by_x = ((of_rgb - back * of_alpha[..., None]).numpy() for of_rgb, of_alpha in zip(*slopes, strict=True))
    seen = ((alone.alpha > FAINT) & (shot.weight > 0)).numpy()
    depth = alone.expected_depth.numpy()[seen].astype(np.float64)
    fx, fy, cx, cy = view.intrinsics
    rows, columns = np.nonzero(seen)
    x, y, one, zero = (columns + 0.5 - cx) / fx, (rows + 0.5 - cy) / fy, np.ones(len(depth)), np.zeros(len(depth))
    camera_from_world = camera.camera_from_world[:3, :3]
    arm = (np.stack([x, y, one], 1) * depth[:, None] - camera_from_vehicle[:3, 3]) @ camera_from_world
    across = (fx / depth)[:, None] * np.stack([one, zero, -x], 1) @ camera_from_world
    down = (fy / depth)[:, None] * np.stack([zero, one, -y], 1) @ camera_from_world
    flow_x, flow_y = (np.hstack([np.cross(arm, flow), flow]) for flow in (across, down))  # [P, 6] pixels by pose
    total = np.zeros((6, 6))
    for c in range(3):
        derivative = by_x[seen, c, None] * flow_x + by_y[seen, c, None] * flow_y
        total += derivative.T @ derivative
    return UNDERRATED * total
