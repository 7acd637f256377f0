"""What a step of a rival draws: the whole frame with its background, or the vehicle's window before a flat image."""

from dataclasses import fields
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from benchmarks.rivals.omnire import RigidNode, Schedule
from dwgs.distill.shots import Shot
from dwgs.scene import Background, Camera
from dwgs.scene.sky import sky_image
from dwgs.splat import Splats, View, project, render

SKY_STRIDE = 4
"""The sky is looked up at every fourth pixel and interpolated: its own pixels are larger."""


class Scenery(Protocol):
    """Frames that teach."""

    def __len__(self) -> int: ...

    def draw(self, i: int, shrink: int, splats: Splats) -> tuple[Tensor, Tensor, View]:
        """Frame ``i``, ``shrink`` times smaller, with the vehicle; the same as it should be; its view of the vehicle.

        Images are [h, w, 3].
        """
        ...

    def size(self, i: int, shrink: int) -> tuple[int, int]:
        """Width and height [px] of the whole frame."""
        ...


class FullFrames:
    """As the field has it: every frame whole, background and vehicle rendered together.

    The background is spared its gradients, which the field computes and throws away.
    """

    def __init__(self, shots: list[Shot], background: Background, threads: int) -> None:
        self._shots, self._threads = shots, threads
        self._splats, self._sky = Splats.from_gaussians(background.gaussians), background.sky
        self._pixels = [_planes(shot.sight.frame.pixels) for shot in shots]
        self._skies: dict[int, Tensor] = {}

    def __len__(self) -> int:
        return len(self._shots)

    def draw(self, i: int, shrink: int, splats: Splats) -> tuple[Tensor, Tensor, View]:
        """See `Scenery`."""
        sight = self._shots[i].sight
        camera = _smaller(sight.camera, shrink)
        view = View.from_camera(camera, sight.world_from_vehicle)
        with torch.no_grad():
            among = project(self._splats, View.from_camera(camera), threads=self._threads)
        rendering = render(splats, view, among=among, threads=self._threads)
        sky = interpolate(self._sky_behind(i)[None], (camera.height, camera.width), mode="bilinear")[0]
        rgb = rendering.rgb.movedim(-1, 0) + (1 - rendering.alpha) * sky
        return rgb.movedim(0, -1), _shrunk(self._pixels[i], camera), view

    def size(self, i: int, shrink: int) -> tuple[int, int]:
        """See `Scenery`."""
        camera = _smaller(self._shots[i].sight.camera, shrink)
        return camera.width, camera.height

    def _sky_behind(self, i: int) -> Tensor:
        """[3, h, w]."""
        if i not in self._skies:
            coarse = _smaller(self._shots[i].sight.camera, SKY_STRIDE)
            self._skies[i] = torch.from_numpy(sky_image(self._sky, coarse)).float().movedim(-1, 0).contiguous()
        return self._skies[i]


class Crops:
    """The same, but only the window around the vehicle, before an image of the background that costs nothing."""

    def __init__(self, shots: list[Shot], threads: int) -> None:
        self._shots, self._threads = shots, threads
        self._pixels = [_planes(shot.pixels) for shot in shots]
        self._flat = []
        for shot in shots:
            camera = shot.sight.region.window.camera(shot.sight.background_camera)
            self._flat.append(shot.frozen.alone(View.from_camera(camera)).movedim(-1, 0).contiguous())

    def __len__(self) -> int:
        return len(self._shots)

    def draw(self, i: int, shrink: int, splats: Splats) -> tuple[Tensor, Tensor, View]:
        """See `Scenery`."""
        sight = self._shots[i].sight
        camera = _smaller(sight.region.window.camera(sight.camera), shrink)
        view = View.from_camera(camera, sight.world_from_vehicle)
        rendering = render(splats, view, threads=self._threads)
        return rendering.over(_shrunk(self._flat[i], camera)), _shrunk(self._pixels[i], camera), view

    def size(self, i: int, shrink: int) -> tuple[int, int]:
        """See `Scenery`."""
        camera = _smaller(self._shots[i].sight.camera, shrink)
        return camera.width, camera.height


class Loop:
    """Steps of OmniRe over some scenery, views drawn at random."""

    def __init__(self, node: RigidNode, scenery: Scenery, schedule: Schedule, seed: int = 0) -> None:
        self.node, self.steps = node, 0
        self._scenery, self.schedule = scenery, schedule
        self._random = np.random.default_rng(seed)

    def step(self) -> None:
        """One more."""
        self.steps += 1
        i, shrink = int(self._random.integers(len(self._scenery))), self.schedule.shrink(self.steps)
        rgb, target, view = self._scenery.draw(i, shrink, self.node.splats(self.steps))
        width, height = self._scenery.size(i, shrink)
        share = rgb.shape[0] * rgb.shape[1] / (width * height)
        self.node.loss(self.steps, rgb, target, share).backward()
        self.node.step(self.steps, view, (width, height))

    def splats(self) -> Splats:
        """The vehicle as it is now, detached."""
        with torch.no_grad():
            splats = self.node.splats(max(self.steps, 1))
        return Splats(*(getattr(splats, f.name).detach() for f in fields(Splats)))


def _smaller(camera: Camera, shrink: int) -> Camera:
    return camera if shrink == 1 else camera.resize(-(-camera.width // shrink), -(-camera.height // shrink))


def _planes(pixels: np.ndarray) -> Tensor:
    """uint8 [3, H, W]."""
    return torch.from_numpy(pixels).movedim(-1, 0).contiguous()


def _shrunk(planes: Tensor, camera: Camera) -> Tensor:
    """[h, w, 3] of [3, H, W], each pixel the mean of what it covers."""
    image = planes / 255 if planes.dtype == torch.uint8 else planes
    size = camera.height, camera.width
    if tuple(image.shape[1:]) != size:
        image = interpolate(image[None], size, mode="area")[0]
    return image.movedim(0, -1)
