"""Wheels are learnt last: a sector of one, drawn as often as it comes round, over what else is in their place.

What the body has learnt there is a wheel's mean over all its angles. Its Gaussians go on learning, while discs that
turn with the way come over them. All wheels are one wheel, and its sectors one sector: what each frame sees at another
angle would else learn every frame by heart.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.distill.config import Recipe
from dwgs.distill.model import BODY_SCALES, CUT, body_bounds
from dwgs.distill.observe import observations
from dwgs.distill.photometric import DSSIM_SHARE
from dwgs.distill.region import window_around
from dwgs.distill.shots import Shot
from dwgs.distill.wheels import Look, Rolling
from dwgs.optimize import Event, SplatParameters, Step, dssim, hold_then_decay, view_order, weighted_l1
from dwgs.optimize.schedule import Pace
from dwgs.scene import Gaussians, VehicleAsset, Wheel
from dwgs.scene.pose import pitch_rotation, quat_from_rotation, quat_product
from dwgs.splat import Splats, View
from dwgs.splat.constants import SH_C0

SPACING = 0.016
"""Between the discs of a wheel at first [m]."""
RIM = 0.75
"""Share of a wheel's radius beyond which is the tyre, which looks alike at every angle."""
PLACE, DEPTH = 0.9, 0.06
"""Within this share of the radius about a hub, and this far from the wheel's face [m], the body's Gaussians go on
learning."""
SHOWN = 1.25
"""Pixels within this share of the radius teach."""
FEWEST = 30
"""Pixels of a frame that teaches."""
APRON = 4
"""Pixels of the window around them."""
THICK = 0.08
"""How far a wheel's Gaussians may leave its face [m], and their largest standard deviation [m]."""
OPACITY, GREY = 0.27, 0.3
"""Of the discs at first."""


def learn_wheels(
    rolling: Rolling, asset: VehicleAsset, recipe: Recipe, schedule: Iterator[Pace], seed: int
) -> Generator[Event, None, VehicleAsset]:
    """The asset with wheels that turn; as it was where the frames that teach get no better by them.

    Args:
        rolling: Where they are.
        asset: Without wheels, whose poses are those of ``rolling.trajectory``.
        recipe: Of the vehicle.
        schedule: Of the steps.
        seed: Chooses the order of the views.
    """
    narrow = [(look.time, shot) for look in rolling.looks if (shot := _narrowed(look, rolling)) is not None]
    own = _near_hubs(asset.body, rolling)
    if not narrow or not own.any():
        return asset
    held = []
    for _, shot in narrow:
        stands = shot.sight.world_from_vehicle
        rest = Gaussians.concatenate([asset.body_at(stands)[~own], asset.shadow_at(stands)])
        held.append(replace(shot, frozen=shot.frozen.holding(Splats.from_gaussians(rest), shot.view)))
    reach = RIM * rolling.radius
    bounds = np.array([[-reach, -THICK, -reach], [reach, THICK, reach]])
    sector = SplatParameters(_sector(rolling), recipe.body, bounds=bounds, max_scales=(THICK,) * 3)
    place = SplatParameters(asset.body[own], recipe.body, bounds=body_bounds(asset.size), max_scales=BODY_SCALES)
    copies = [_Copies.of(rolling, rolling.angles(time)) for time, _ in narrow]

    def error(i: int, *clouds: Splats) -> Tensor:
        shot = held[i]
        rgb = shot.frozen.render(Splats.cat([place.splats(), *clouds]), shot.view, threads=1).rgb
        return _error(shot, shot.frozen.exposed(rgb))

    def error_with_wheels(i: int) -> Tensor:
        return error(i, copies[i].of_sector(sector.splats()))

    with torch.no_grad():
        before = sum(error(i).item() for i in range(len(held)))
    for pace, i in zip(schedule, view_order(len(held), seed), strict=False):
        loss = error_with_wheels(i)
        loss.backward()
        factor = hold_then_decay(pace.progress, recipe.hold, recipe.final)
        sector.step(factor)
        place.step(factor)
        yield Step(pace.step, pace.steps, loss.item())
    with torch.no_grad():
        after = sum(error_with_wheels(i).item() for i in range(len(held)))
    if after >= before:
        return asset
    hidden = np.zeros(len(asset.body), bool) if rolling.is_other_side_seen else _is_hidden(asset, rolling)
    return _assembled(asset, rolling, (own, hidden), place.to_gaussians(), sector.to_gaussians())


@dataclass(frozen=True)
class _Copies:
    """Where the sectors of both wheels are at one moment, wheel by wheel."""

    rotations: Tensor
    """[copies, 3, 3]."""
    quat_matrices: Tensor
    """[copies, 4, 4] what the same does to quaternions."""
    hubs: Tensor
    """[copies, 3] [m]."""

    @staticmethod
    def of(rolling: Rolling, angles: NDArray[np.float64]) -> "_Copies":
        """Of wheels that are turned by ``angles`` [2] [rad]."""
        parts = 2 * np.pi * np.arange(rolling.spokes) / rolling.spokes
        rotations = pitch_rotation((angles[:, None] + parts).reshape(-1))
        turns = quat_from_rotation(rotations)
        quat_matrices = np.stack([quat_product(turns, axis) for axis in np.eye(4)], -1)
        hubs = np.repeat(rolling.hubs, rolling.spokes, axis=0)
        return _Copies(*(torch.from_numpy(part).float() for part in (rotations, quat_matrices, hubs)))

    def of_sector(self, sector: Splats) -> Splats:
        """All of them, differentiable."""
        count = len(self.hubs)
        means = sector.means @ self.rotations.mT + self.hubs[:, None]
        quats = sector.quats @ self.quat_matrices.mT
        scales, opacities, sh = sector.scales, sector.opacities, sector.sh
        return Splats(
            means.reshape(-1, 3),
            quats.reshape(-1, 4),
            scales.repeat(count, 1),
            opacities.repeat(count),
            sh.repeat(count, 1, 1),
        )


def _sector(rolling: Rolling) -> Gaussians:
    """Grey discs on one of a wheel's equal sectors, about its hub."""
    places = []
    for ring in np.arange(0.75 * SPACING, RIM * rolling.radius, SPACING):
        part = 2 * np.pi / rolling.spokes
        count = max(1, round(ring * part / SPACING))
        angles = (np.arange(count) + 0.5) / count * part
        places.append(ring * np.stack([np.cos(angles), 0 * angles, -np.sin(angles)], 1))
    means = np.concatenate(places).astype(np.float32)
    n = len(means)
    return Gaussians(
        means,
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.tile(np.array([0.6, 0.25, 0.6], np.float32) * np.float32(SPACING), (n, 1)),
        np.full(n, OPACITY, np.float32),
        np.full((n, 1, 3), (GREY - 0.5) / SH_C0, np.float32),
    )


def _narrowed(look: Look, rolling: Rolling) -> Shot | None:
    """The shot, of which only the wheels' pixels are compared; None where they are too few."""
    shot, view = look.shot, look.view
    matrix, (fx, fy, cx, cy) = view.viewmat.double().numpy(), view.lenses[0].tolist()
    x, y = np.meshgrid((np.arange(view.width) + 0.5 - cx) / fx, (np.arange(view.height) + 0.5 - cy) / fy)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ matrix[:3, :3]
    eye = -matrix[:3, :3].T @ matrix[:3, 3]
    shown = np.zeros(x.shape, bool)
    for hub in rolling.hubs:
        way = (hub[1] - eye[1]) / rays[..., 1:2]
        reach = np.linalg.norm((eye + way * rays - hub)[..., [0, 2]], axis=-1)
        shown |= (way[..., 0] > 0) & (reach < SHOWN * rolling.radius)
    shown &= shot.sight.region.supervised
    if np.count_nonzero(shown) < FEWEST:
        return None
    window = window_around(shown, APRON)
    narrow = View(view.viewmat, (fx, fy, cx - window.x, cy - window.y), window.width, window.height)
    target, weight = shot.target[window.slices], torch.from_numpy(window.of(shown).astype(np.float32))
    return replace(shot, view=narrow, frozen=shot.frozen.within(window), target=target, weight=weight)


def _near_hubs(body: Gaussians, rolling: Rolling) -> NDArray[np.bool_]:
    """[body] those in the place of a wheel."""
    from_hubs = np.abs(body.means - rolling.hubs[:, None])
    reach = np.hypot(from_hubs[..., 0], from_hubs[..., 2])
    return np.any((reach < PLACE * rolling.radius) & (from_hubs[..., 1] < DEPTH), axis=0)


def _error(shot: Shot, rgb: Tensor) -> Tensor:
    """How a picture differs from the frame: the robust loss of `photometric`."""
    l1 = weighted_l1(rgb, shot.target, shot.weight)
    return (1 - DSSIM_SHARE) * l1 + DSSIM_SHARE * dssim(rgb, shot.target, shot.weight)


def _is_hidden(asset: VehicleAsset, rolling: Rolling) -> NDArray[np.bool_]:
    """[body] those in the place of a wheel of the other side that no frame sees, from behind or through a gap."""

    def whole(shot: Shot) -> Gaussians:
        return Gaussians.concatenate([asset.body, asset.shadow_at(shot.sight.world_from_vehicle)])

    looks = ((look.shot, look.view, whole(look.shot)) for look in rolling.looks)
    return _near_hubs(asset.body.mirrored(), rolling) & (observations(looks, len(asset.body), threads=1) == 0)


def _assembled(
    asset: VehicleAsset,
    rolling: Rolling,
    own_hidden: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    place: Gaussians,
    sector: Gaussians,
) -> VehicleAsset:
    """The asset with what was learnt in place of its own; a side that no frame shows gets its mirror image."""
    own, hidden = own_hidden
    stays, place, sector = asset.body[~own & ~hidden], place[place.opacities >= CUT], sector[sector.opacities >= CUT]
    rolls = _Copies.of(rolling, rolling.phases).of_sector(Splats.from_gaussians(sector)).to_gaussians()
    count = rolling.spokes * len(sector)
    wheels = [Wheel(hub, rolling.radius, count) for hub in rolling.hubs]
    parts = [place, rolls]
    if not rolling.is_other_side_seen:
        parts = [place, place.mirrored(), rolls, rolls.mirrored()]
        wheels += [Wheel(hub * [1, -1, 1], rolling.radius, count) for hub in rolling.hubs]
    body, shading = Gaussians.concatenate([stays, *parts]), asset.shading
    if shading is not None:  # what was learnt here is lit alike wherever the sun is
        by_slope = np.zeros((len(body), *shading.by_slope.shape[1:]), np.float32)
        by_slope[: len(stays)] = shading.by_slope[~own & ~hidden]
        shading = replace(shading, by_slope=by_slope)
    return replace(asset, body=body, wheels=tuple(wheels), shading=shading)
