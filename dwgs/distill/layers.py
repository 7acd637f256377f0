"""The frozen background as exact layers in front of and behind a vehicle.

A pixel is composited by the depth of Gaussian *centres*. The vehicle's centres lie in an interval of depth
known beforehand, so the background splits once per frame into what is always before it, what is always behind
it, and what lies between. The first two become images; the rest stays as projected records and is composited
with the vehicle, Gaussian by Gaussian. The picture is that of both clouds in one pass, but for what the
stopping rule lets pass.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.distill.region import Window
from dwgs.distill.traffic import Driven, Traffic
from dwgs.scene import Background, Camera, Frame, Gaussians, Track, Trajectory
from dwgs.scene.pose import inverse, transform_points
from dwgs.scene.sky import pixel_rays, sky_colors
from dwgs.splat import Layers, Picture, Projected, Rendering, RetainedCloud, Splats, View, composite, project, render
from dwgs.splat.constants import STOP_TRANSMITTANCE

DEPTH_SLACK = 1e-3
"""Widens an interval of depths [m]: the renderer computes them in float32."""


@dataclass(frozen=True)
class FrozenView:
    """One window of one frame, without the vehicle, ready to be composited with it."""

    layers: Layers
    """What is before every centre of the vehicle, and what is behind, with the sky."""
    between: Projected
    """Background Gaussians among those of the vehicle."""
    gain: Tensor
    """[3] exposure of this camera, on the composited colour."""

    def render(self, vehicle: Splats, view: View, threads: int) -> Rendering:
        """The window with a vehicle in it, before exposure."""
        return render(vehicle, view, self.layers, among=self._among, threads=threads)

    def retain(self, vehicle: RetainedCloud, view: View) -> Picture:
        """The same of a vehicle that is drawn in it again and again."""
        return vehicle.picture(view, self.layers, self._among)

    def within(self, window: Window) -> "FrozenView":
        """Only a ``window`` of the window."""
        layers = self.layers.crop(*window.slices)
        records = self.between.records.clone()
        records[:, :2] -= torch.tensor([window.x, window.y])
        size = torch.tensor([window.width, window.height])
        reaches = (records[:, :2] > -records[:, 10:12]) & (records[:, :2] < size + records[:, 10:12])
        return FrozenView(layers, Projected(records[reaches.all(1)]), self.gain)

    def holding(self, vehicle: Splats, view: View) -> "FrozenView":
        """With a vehicle frozen in it, too."""
        with torch.no_grad():
            projected = project(vehicle, view, threads=1)
        records = torch.cat([self.between.records, projected[projected.visible].records])
        return FrozenView(self.layers, Projected(records), self.gain)

    @property
    def _among(self) -> Projected | None:
        return self.between if len(self.between) else None

    def alone(self, view: View) -> Tensor:
        """[h, w, 3] the window without the vehicle, exposed."""
        return self.exposed(composite(self.between, view, self.layers, threads=1).rgb)

    def exposed(self, rgb: Tensor) -> Tensor:
        """The colours [h, w, 3] as the camera shows them."""
        return rgb * self.gain if self.has_gain else rgb

    @cached_property
    def has_gain(self) -> bool:
        """Whether exposing changes anything."""
        return bool((self.gain != 1).any())


class Frozen(Protocol):
    """What a vehicle is learnt against: whatever can be split about it, frame by frame, and stays as it is."""

    def camera(self, frame: Frame) -> Camera:
        """Where the frame's camera really was."""
        ...

    def freeze(self, camera: Camera, camera_name: str, interval: tuple[float, float]) -> FrozenView:
        """Split what a camera (or a window of it) sees at an ``interval`` of centre depths [m]; thread-safe."""
        ...

    def unexplained(self, tracks: Sequence[Track], time: float) -> Sequence[Track]:
        """Those recorded vehicles that it does not show at a ``time`` [s]: they are masked where they move."""
        ...

    def fingerprint(self) -> str:
        """A hash of all of it."""
        ...


class FrozenBackground:
    """A background as the splatter wants it, and where its cameras really are. Nothing is written to it.

    Args:
        background: The street.
        frames: Of the cameras.
        traffic: Vehicles that drive there besides the one to be learnt, as frozen as the street, see `others`.
    """

    def __init__(
        self, background: Background, frames: tuple[Frame, ...] | list[Frame], traffic: Sequence[Driven] = ()
    ) -> None:
        self._background, self._traffic = background, Traffic(traffic)
        self._splats = Splats.from_gaussians(background.gaussians)
        self._corrections = _corrections(background, frames)

    def camera(self, frame: Frame) -> Camera:
        """The frame's camera as the background was fitted with it, interpolated where it was not."""
        correction = self._corrections.get(frame.camera_name)
        if correction is None:
            return frame.camera
        return frame.camera.at(frame.camera.world_from_camera @ correction.at(frame.camera.time))

    def unexplained(self, tracks: Sequence[Track], time: float) -> Sequence[Track]:
        """Those that the traffic has not."""
        return self._traffic.unexplained(tracks, time)

    def fingerprint(self) -> str:
        """Of every number of the background and the traffic."""
        return fingerprint(self._background, self._traffic.vehicles)

    def freeze(self, camera: Camera, camera_name: str, interval: tuple[float, float]) -> FrozenView:
        """Split the view of a camera at an ``interval`` of centre depths [m]; thread-safe."""
        view = View.from_camera(camera)
        with torch.no_grad():
            street = project(self._splats, view, threads=1)
            projected = Projected(torch.cat([street[street.visible].records, *self._traffic.records(camera)]))
            before, behind = projected.depths < interval[0], projected.depths > interval[1]
            front = composite(projected[before], view, threads=1)
            back = composite(projected[behind], view, threads=1)
            open_sky = 1 - back.alpha >= STOP_TRANSMITTANCE  # elsewhere it counts as little as what is not drawn
            sky = torch.from_numpy(sky_colors(self._background.sky, pixel_rays(camera)[open_sky.numpy()]))
            back.rgb[open_sky] += (1 - back.alpha[open_sky])[:, None] * sky
            layers = Layers.between(front, back)
            gain = self._background.exposure.get(camera_name, np.ones(3, np.float32))
            return FrozenView(layers, projected[~before & ~behind], torch.from_numpy(gain))


def depth_interval(
    camera_from_vehicle: NDArray[np.float64], bounds: NDArray[np.float64], slack: float
) -> tuple[float, float]:
    """Depths [m] between which centres inside ``bounds`` [2, 3] of the vehicle frame lie, plus ``slack``."""
    corners = np.array([[x, y, z] for x in bounds[:, 0] for y in bounds[:, 1] for z in bounds[:, 2]])
    depth = transform_points(camera_from_vehicle, corners)[:, 2]
    return float(depth.min() - slack - DEPTH_SLACK), float(depth.max() + slack + DEPTH_SLACK)


def fingerprint(background: Background, traffic: Sequence[Driven] = ()) -> str:
    """A hash of every number of a background and its traffic: equal before and after means left alone."""
    digest = hashlib.sha256()

    def add(g: Gaussians) -> None:
        for array in (g.means, g.quats, g.scales, g.opacities, g.sh):
            digest.update(array.tobytes())

    add(background.gaussians)
    digest.update(background.sky.tobytes())
    for key in sorted(background.exposure):
        digest.update(background.exposure[key].tobytes())
    for key in sorted(background.poses):
        digest.update(background.poses[key].tobytes())
    for asset, trajectory in traffic:
        add(asset.gaussians)
        digest.update(trajectory.times.tobytes() + trajectory.world_from_vehicle.tobytes())
    return digest.hexdigest()


def _corrections(background: Background, frames) -> dict[str, Trajectory]:
    """Camera name to ``recorded_from_refined`` over time."""
    known: dict[str, list[tuple[float, NDArray[np.float64]]]] = {}
    for frame in sorted(frames, key=lambda f: f.camera.time):
        refined = background.poses.get((frame.camera_name, frame.index))
        if refined is not None:
            correction = inverse(frame.camera.world_from_camera) @ refined
            known.setdefault(frame.camera_name, []).append((frame.camera.time, correction))
    return {
        name: Trajectory(np.array([t for t, _ in pairs]), np.array([c for _, c in pairs]))
        for name, pairs in known.items()
    }
