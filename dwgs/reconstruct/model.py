"""The street while it is learnt: Gaussians before a sky, camera poses, exposure."""

from collections.abc import Mapping
from dataclasses import astuple
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate

from dwgs.optimize import PoseParameters, SplatParameters
from dwgs.reconstruct.config import NEAREST, RATES, UNIT_DISTANCE
from dwgs.reconstruct.traffic import LARGEST, Group, Traffic
from dwgs.scene import Background, Camera, Frame, Gaussians, Scene
from dwgs.scene.pose import pose
from dwgs.scene.sky import sky_image
from dwgs.splat import Objects, Rendering, View, render

SKY_STRIDE = 4
"""The sky is looked up at every fourth pixel and interpolated: its own pixels are larger."""
ROTATION_RATE, TRANSLATION_RATE, GAIN_RATE = 2e-5, 2e-4, 2e-3
"""Step sizes of camera poses [rad], [m] and of the logarithm of exposure."""


class Street:
    """Everything that a step of the reconstruction changes."""

    def __init__(
        self, scene: Scene, frames: list[Frame], gaussians: Gaussians, sky: NDArray[np.float32], traffic: Traffic
    ) -> None:
        self.frames, self.traffic = frames, traffic
        self.sky = sky
        self._positions = torch.tensor(np.array([f.camera.position for f in frames]), dtype=torch.float32)
        begin = [(Group(-1, len(gaussians)), gaussians), *traffic.begin()]
        self._groups = [group for group, _ in begin]
        cloud, step_scale = self._joined(begin)
        self._splats = SplatParameters(cloud, RATES, step_scale)
        self._poses = PoseParameters(len(frames), ROTATION_RATE, TRANSLATION_RATE)
        self._cameras = list(scene.frames)
        self._log_gains = torch.zeros(len(self._cameras), 3, requires_grad=len(self._cameras) > 1)
        self._gain_optimizer = torch.optim.Adam([self._log_gains], lr=GAIN_RATE, betas=(0.9, 0.99))
        self._skies: dict[tuple[int, int], Tensor] = {}

    def __len__(self) -> int:
        return len(self._splats)

    def show(self, i: int, camera: Camera, threads: int) -> tuple[Tensor, Rendering]:
        """Colours [H, W, 3] of frame ``i`` through its ``camera`` at any resolution, and their rendering."""
        view = View.from_camera(camera)
        # world_from_refined = world_from_recorded @ correction
        refined = View(_inverse(self._poses.matrix(i)) @ view.viewmat, view.intrinsics, view.width, view.height)
        poses = torch.cat([self.traffic.poses(i), torch.eye(4)[None]])  # the street is number -1
        objects = Objects(tuple(g.count for g in self._groups), poses[[g.owner for g in self._groups]])
        rendering = render(self._splats.splats(), refined, objects=objects, threads=threads)
        # Plane by plane, as the renderer stores them.
        rgb = rendering.rgb.permute(2, 0, 1) + (1 - rendering.alpha) * self._sky_behind(i, camera)
        name = self.frames[i].camera_name
        if name != self._cameras[0]:
            rgb = rgb * self._gain(name)[:, None, None]
        return rgb.permute(1, 2, 0), rendering

    def step(self, factor: float) -> None:
        """One step along the gradients, rates times ``factor``."""
        self._splats.step(factor)
        self._poses.step(factor)
        self.traffic.step(factor)
        if self._log_gains.grad is not None:
            self._gain_optimizer.step()
            self._gain_optimizer.zero_grad(set_to_none=True)

    def state_dict(self) -> dict[str, Any]:
        """Everything that further steps depend on."""
        return {
            "splats": self._splats.state_dict(),
            "poses": self._poses.state_dict(),
            "traffic": self.traffic.state_dict(),
            "groups": [astuple(group) for group in self._groups],
            "log_gains": self._log_gains.detach(),
            "gain_optimizer": self._gain_optimizer.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Be what `state_dict` gave, as grown as that."""
        self._splats.load_state_dict(state["splats"])
        self._poses.load_state_dict(state["poses"])
        self.traffic.load_state_dict(state["traffic"])
        self._groups = [Group(*group) for group in state["groups"]]
        with torch.no_grad():
            self._log_gains.copy_(state["log_gains"])
        self._gain_optimizer.load_state_dict(dict(state["gain_optimizer"]))

    def grow(self, seedlings: Mapping[int, Gaussians]) -> None:
        """Add Gaussians that stand in the world at the time of a frame: those in a box become its vehicle's."""
        fresh = [group for i, gaussians in seedlings.items() for group in self.traffic.adopt(i, gaussians)]
        owners = {group.owner for group, _ in fresh}
        merged = [Gaussians.concatenate([c for g, c in fresh if g.owner == owner]) for owner in sorted(owners)]
        fresh = [(Group(owner, len(cloud)), cloud) for owner, cloud in zip(sorted(owners), merged, strict=True)]
        self._groups += [group for group, _ in fresh]
        self._splats.append(*self._joined(fresh))

    def confine(self) -> None:
        """Put back into their boxes what strayed from them."""
        begin = 0
        for group in self._groups:
            if group.owner >= 0 and not group.is_shadow:
                bounds = torch.from_numpy(self.traffic.bounds(group.owner)).float()
                self._splats.confine(slice(begin, begin + group.count), bounds, LARGEST)
            begin += group.count

    def _joined(self, groups: list[tuple[Group, Gaussians]]) -> tuple[Gaussians, Tensor]:
        """All as one cloud, and how far their means step."""
        scales = [self.step_scale(c) if g.owner < 0 else self.traffic.step_scale(g) for g, c in groups]
        return Gaussians.concatenate([cloud for _, cloud in groups]), torch.cat(scales)

    def groups(self) -> list[tuple[Group, Gaussians]]:
        """All Gaussians as they are now, by what they belong to."""
        ends = np.cumsum([group.count for group in self._groups])
        cloud = self._splats.to_gaussians()
        return [(group, cloud[end - group.count : end]) for group, end in zip(self._groups, ends, strict=True)]

    def step_scale(self, gaussians: Gaussians) -> Tensor:
        """Distance of each Gaussian [N] in `UNIT_DISTANCE`: so scaled, one step moves as many pixels."""
        means = torch.from_numpy(gaussians.means)
        nearest = torch.full((len(means),), torch.inf)
        for position in self._positions[:: max(1, len(self._positions) // 16)]:
            nearest = torch.minimum(nearest, (means - position).norm(dim=1))
        return nearest.clamp_min(NEAREST) / UNIT_DISTANCE

    def camera(self, i: int) -> Camera:
        """The refined camera of frame ``i``."""
        camera = self.frames[i].camera
        return camera.at(camera.world_from_camera @ self._correction(i))

    def camera_of(self, frame: Frame) -> Camera:
        """The camera of a frame that took no part: its neighbours' corrections, interpolated in time."""
        same = [i for i, f in enumerate(self.frames) if f.camera_name == frame.camera_name]
        times = [self.frames[i].camera.time for i in same]
        six = torch.cat([self._poses.rotations, self._poses.translations], 1).detach()[same].numpy()
        between = [np.interp(frame.camera.time, times, six[:, k]) for k in range(6)]
        return frame.camera.at(frame.camera.world_from_camera @ _rigid(np.array(between)))

    def to_background(self, heldout: list[Frame]) -> Background:
        """The frozen street."""
        poses = {(f.camera_name, f.index): self.camera(i).world_from_camera for i, f in enumerate(self.frames)}
        poses |= {(f.camera_name, f.index): self.camera_of(f).world_from_camera for f in heldout}
        gains = {name: self._gain(name).detach().numpy() for name in self._cameras[1:]}
        gaussians = Gaussians.concatenate([cloud for group, cloud in self.groups() if group.owner < 0])
        return Background(gaussians[gaussians.opacities >= 1 / 255], self.sky, gains, poses)

    def pose_corrections(self) -> tuple[float, float]:
        """Root mean square of the rotations [rad] and of the translations [m]."""
        sizes = (self._poses.rotations.norm(dim=1), self._poses.translations.norm(dim=1))
        rotation, translation = (float(s.detach().square().mean().sqrt()) for s in sizes)
        return rotation, translation

    def _gain(self, camera_name: str) -> Tensor:
        return self._log_gains[self._cameras.index(camera_name)].exp()

    def _correction(self, i: int) -> NDArray[np.float64]:
        six = torch.cat([self._poses.rotations[i], self._poses.translations[i]])
        return _rigid(six.detach().double().numpy())

    def _sky_behind(self, i: int, camera: Camera) -> Tensor:
        """[3, H, W] of the sky; its pixels are so large that the correction of a pose does not matter."""
        key = i, camera.width
        if key not in self._skies:
            coarse = camera.resize(-(-camera.width // SKY_STRIDE), -(-camera.height // SKY_STRIDE))
            self._skies[key] = torch.from_numpy(sky_image(self.sky, coarse)).permute(2, 0, 1)[None]
        size = (camera.height, camera.width)
        return interpolate(self._skies[key], size, mode="bilinear", align_corners=False)[0]


def _inverse(a_from_b: Tensor) -> Tensor:
    """[4, 4] of a rigid transform, differentiable."""
    rotation = a_from_b[:3, :3].T
    upper = torch.cat([rotation, -(rotation @ a_from_b[:3, 3:])], 1)
    return torch.cat([upper, a_from_b[3:]])


def _rigid(six: NDArray) -> NDArray[np.float64]:
    """[4, 4] from a rotation vector and a translation."""
    x, y, z = six[:3]
    skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return pose(torch.matrix_exp(skew).numpy(), six[3:])
