"""The vehicle, to take home."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dwgs.scene.gaussians import Gaussians
from dwgs.scene.pose import pitch_rotation, quat_from_rotation, quat_product
from dwgs.scene.trajectory import Trajectory


@dataclass(frozen=True)
class Casting:
    """How a shadow was cast: the vehicle turns, and the sun does not."""

    sun: NDArray[np.float64]
    """[3] unit vector towards the sun in the world."""
    sun_at_rest: NDArray[np.float64]
    """[3] the same in the vehicle's frame, while its shadow lies where its Gaussians are."""
    heights: NDArray[np.float32]
    """[shadow] how high above the ground what casts each Gaussian is [m]."""

    def slope_at(self, world_from_vehicle: NDArray[np.float64]) -> NDArray[np.float64]:
        """[2] by how much a Gaussian is off, per metre of its height, in the frame of a vehicle that stands there."""
        now = world_from_vehicle[:3, :3].T @ self.sun
        return self.sun_at_rest[:2] / self.sun_at_rest[2] - now[:2] / now[2]


@dataclass(frozen=True)
class Shading:
    """How the colours of a body follow the sun as the vehicle turns, to first order."""

    by_slope: NDArray[np.float32]
    """[body, 2, 3] change of each Gaussian's first coefficients, per `Casting.slope_at`."""
    slopes: NDArray[np.float64]
    """[2, 2] lowest and highest that frames showed: beyond these, colours stay as they are there."""

    def at(self, slope: NDArray[np.float64]) -> NDArray[np.float32]:
        """[body, 3] the change there."""
        return np.einsum("nkc,k->nc", self.by_slope, np.clip(slope, *self.slopes).astype(np.float32))


@dataclass(frozen=True)
class Wheel:
    """Gaussians of a body that roll with the way driven; light stays where it is: colours do not turn with them."""

    hub: NDArray[np.float64]
    """[3] what they turn about, in the vehicle's frame [m]; the axle lies across the vehicle."""
    radius: float
    """So far a vehicle drives while its wheel turns by one radian [m]."""
    count: int
    """How many of the body's Gaussians are its own."""

    def turned(self, own: Gaussians, way: float) -> Gaussians:
        """Its ``own`` Gaussians at rest, once the hub has come forward by a ``way`` [m]."""
        rotation = pitch_rotation(way / self.radius)
        means = self.hub + (own.means - self.hub) @ rotation.T
        quats = quat_product(quat_from_rotation(rotation), own.quats)
        return replace(own, means=means.astype(np.float32), quats=quats.astype(np.float32))


@dataclass(frozen=True)
class VehicleAsset:
    """Gaussians in the vehicle's own frame (box centre, x forward, y left, z up): they need no scene."""

    body: Gaussians
    """What lies on the vehicle, its wheels as they are before it drives."""
    shadow: Gaussians
    """What the vehicle takes away from the ground around it: dark, flat, outside the box."""
    size: NDArray[np.float64]
    """[3] (length, width, height) [m]."""
    category: str = "car"
    """Class of vehicle."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Where it comes from: scene, generator, versions, seed, settings. JSON values."""
    quality: dict[str, Any] = field(default_factory=dict)
    """What was measured: held-out PSNR and SSIM, sides seen, corrections of poses. JSON values."""
    observations: NDArray[np.uint32] | None = None
    """[body] how many frames saw each Gaussian; those that none saw are as they were put there."""
    casting: Casting | None = None
    """How the shadow was cast; None: it turns with the vehicle."""
    shading: Shading | None = None
    """How colours follow the sun of the `casting`; None: they stay."""
    wheels: tuple[Wheel, ...] = ()
    """What of the body rolls: the last of its Gaussians, wheel by wheel."""

    @property
    def gaussians(self) -> Gaussians:
        """Body and shadow as one cloud."""
        return Gaussians.concatenate([self.body, self.shadow])

    def shadow_at(self, world_from_vehicle: NDArray[np.float64]) -> Gaussians:
        """The shadow as it lies under a vehicle that stands at [4, 4]; the very one where it turns with the vehicle."""
        if self.casting is None:
            return self.shadow
        means = self.shadow.means.copy()
        means[:, :2] += self.casting.heights[:, None] * self.casting.slope_at(world_from_vehicle).astype(np.float32)
        return replace(self.shadow, means=means)

    def body_at(self, world_from_vehicle: NDArray[np.float64]) -> Gaussians:
        """The body as it is lit where the vehicle stands at [4, 4]; the very one where its colours stay."""
        if self.casting is None or self.shading is None:
            return self.body
        sh = self.body.sh.copy()
        sh[:, 0] += self.shading.at(self.casting.slope_at(world_from_vehicle))
        return replace(self.body, sh=sh)

    def parts_at(self, trajectory: Trajectory, time: float) -> list[Gaussians]:
        """The body in the vehicle's frame at a ``time`` [s] of a drive: what stays, then each wheel, turned.

        In the order of its Gaussians. What stays is the very same cloud at all times, if its colours stay, too.
        """
        lit = self.body_at(trajectory.at(time))
        clouds = self._at_rest if lit is self.body else self._divided(lit)
        rolled = [
            wheel.turned(own, float(trajectory.driven(time, wheel.hub)))
            for wheel, own in zip(self.wheels, clouds[1:], strict=True)
        ]
        return [clouds[0], *rolled]

    @cached_property
    def _at_rest(self) -> list[Gaussians]:
        """What stays of the body, then each wheel."""
        return self._divided(self.body)

    def _divided(self, body: Gaussians) -> list[Gaussians]:
        """What stays of a body, then each wheel."""
        if not self.wheels:
            return [body]
        ends = np.cumsum([len(body) - sum(wheel.count for wheel in self.wheels), *(w.count for w in self.wheels)])
        return [body[begin:end] for begin, end in zip([0, *ends], ends, strict=False)]
