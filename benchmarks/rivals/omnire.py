"""A rigid vehicle as OmniRe learns it before a frozen background (Chen et al., 2025; DriveStudio's omnire.yaml).

Its initialisation, rates, losses, and its schedule with growth, culls and resets. Where it differs: SSIM is
`dwgs.optimize.dssim`, the renderer this project's, both faster on a CPU than what they replace. OmniRe grows by
absolute sums of the projected means' gradients, which this renderer does not keep: plain sums are held against the
threshold that belongs to them (Kerbl et al., 2023). Culls by size are left out. So are the losses on depth and
sky, which are off inside an insertion.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from dwgs.optimize import dssim, weighted_l1
from dwgs.scene import Gaussians, LidarSweep, VehiclePoints
from dwgs.splat import Splats, View
from dwgs.splat.constants import SH_C0

STEPS = 30_000
"""Of its schedule; all other steps below are counted in it."""
POINTS, OPACITY, THINNEST = 5000, 0.1, 0.002
"""At the start: so many points of the vehicle, how opaque they are, and their smallest radius [m]."""
RATES = {"quats": 1e-3, "scales": 5e-3, "opacities": 5e-2, "sh_dc": 2.5e-3, "sh_rest": 1.25e-4}
MEANS_RATE, MEANS_FINAL = 1.6e-4, 1.6e-6
"""From the first step to the last, times the radius of the scene."""
SH_EVERY, SH_DEGREE = 1000, 3
"""Steps after which colours get one degree more, up to this."""
COARSE_EVERY, COARSEST = 250, 4
"""Steps after which images become twice as large, from a fourth."""
WARM_UP, REFINE_EVERY, GROW_UNTIL = 500, 100, 20_000
RESET_EVERY, RESET_OPACITY, SETTLE = 3000, 0.01, 100
GROWTH_GRADIENT, GROWTH_SCALE = 2e-4, 3e-3
"""Gaussians grow whose mean moves an image of size 2 so much; beyond this scale (times the radius) they split."""
CULL_OPACITY = 5e-3
SPLIT = 1.6
"""Both halves, and what was split, are thinner by this."""
SHARP_EVERY, SHARP_RATIO = 10, 10.0
"""How often, and from which ratio of its axes on, a Gaussian is held to be round."""
SSIM_SHARE = 0.2


def scene_radius(sweeps: Sequence[LidarSweep]) -> float:
    """Half the extent [m] of what the LiDAR saw, the farthest 2 % on each side left out."""
    points = np.concatenate([sweep.points for sweep in sweeps])
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    high[2] = max(high[2], 20.0)
    return float(1.1 * (high - low).max() / 2)


@dataclass(frozen=True)
class Schedule:
    """OmniRe's, over as many steps as wanted: all that happens at some step of its own happens in proportion."""

    steps: int = STEPS
    views: int = 1
    """So many after a reset nothing grows."""

    def at(self, step: float) -> float:
        """The step of the original, from 1."""
        return step * STEPS / self.steps

    def comes(self, step: int, every: int) -> bool:
        """Whether a multiple of ``every`` steps of the original is passed."""
        return int(self.at(step) // every) > int(self.at(step - 1) // every)

    def shrink(self, step: int) -> int:
        """How many times smaller images are."""
        return max(COARSEST >> int(self.at(step - 1) // COARSE_EVERY), 1)

    @property
    def coarse_steps(self) -> int:
        """Steps before images have their full size."""
        return next(step for step in itertools.count() if self.shrink(step + 1) == 1)

    def degree(self, step: int) -> int:
        """Of the colours."""
        return min(int(self.at(step) // SH_EVERY), SH_DEGREE)

    def refines(self, step: int) -> bool:
        """Whether Gaussians are culled, and may grow."""
        settled = self.at(step) % RESET_EVERY > max(self.views, SETTLE)
        return self.comes(step, REFINE_EVERY) and self.at(step) > WARM_UP and settled

    def resets(self, step: int) -> bool:
        """Whether all become faint: SETTLE steps after every RESET_EVERY."""
        before = step - SETTLE * self.steps / STEPS
        now, then = (int(self.at(s) // RESET_EVERY) for s in (before, before - 1))
        return now > max(then, 0)


class RigidNode:
    """The vehicle's Gaussians and their optimiser.

    Args:
        points: Of the vehicle.
        shadow: Discs that a shadow can be learnt with, which OmniRe lacks: given, so that it can be right.
        bounds: [2, 3] lowest and highest place of a centre [m]: whoever leaves is culled.
        radius: Of the scene [m].
        schedule: When what happens.
        seed: Of everything random.
    """

    def __init__(
        self,
        points: VehiclePoints,
        shadow: Gaussians,
        bounds: NDArray,
        radius: float,
        schedule: Schedule,
        seed: int = 0,
    ) -> None:
        self._bounds, self._radius, self._schedule = torch.from_numpy(np.float32(bounds)), radius, schedule
        self._random = torch.Generator().manual_seed(seed)
        cloud = Gaussians.concatenate([_body(points, seed), shadow])
        means, quats, scales, opacities, sh = (
            torch.from_numpy(getattr(cloud, f).copy()) for f in ("means", "quats", "scales", "opacities", "sh")
        )
        rest = torch.zeros(len(cloud), (SH_DEGREE + 1) ** 2 - 1, 3)
        values = {"means": means, "quats": quats, "scales": scales.log(), "opacities": opacities.logit()}
        values |= {"sh_dc": sh[:, :1].contiguous(), "sh_rest": rest}
        rates = {"means": MEANS_RATE * radius} | RATES
        groups = [{"params": [v.requires_grad_()], "lr": rates[k], "name": k} for k, v in values.items()]
        self._adam = torch.optim.Adam(groups, eps=1e-15, fused=True)
        self._forget()

    def __len__(self) -> int:
        return len(self._raw("means"))

    def splats(self, step: int) -> Splats:
        """As they are drawn at a step; a gradient flows to the parameters."""
        count = (self._schedule.degree(step) + 1) ** 2
        sh = torch.cat([self._raw("sh_dc"), self._raw("sh_rest")[:, : count - 1]], 1)
        scales, opacities = self._raw("scales").exp(), self._raw("opacities").sigmoid()
        return Splats(self._raw("means"), self._raw("quats"), scales, opacities, sh)

    def loss(self, step: int, rgb: Tensor, target: Tensor, share: float) -> Tensor:
        """Of images [H, W, 3] that are a ``share`` of the whole: the same gradient as if all of it was compared."""
        weight = torch.ones(rgb.shape[:2])
        l1, structure = weighted_l1(rgb, target, weight), 2 * dssim(rgb, target, weight)
        loss = share * ((1 - SSIM_SHARE) * l1 + SSIM_SHARE * structure)
        if self._schedule.comes(step, SHARP_EVERY):
            scales = self._raw("scales").exp()
            ratio = scales.amax(1) / scales.amin(1)
            loss = loss + (ratio.clamp_min(SHARP_RATIO) - SHARP_RATIO).mean()
        return loss

    def step(self, step: int, view: View, size: tuple[int, int]) -> None:
        """One step along the gradients of a picture in ``view``, a window of an image of ``size`` (width, height)."""
        self._remember(view, size)
        progress = min(self._schedule.at(step) / STEPS, 1.0)
        for group in self._adam.param_groups:
            if group["name"] == "means":
                group["lr"] = self._radius * MEANS_RATE * (MEANS_FINAL / MEANS_RATE) ** progress
        self._adam.step()
        self._adam.zero_grad()
        with torch.no_grad():
            if self._schedule.refines(step):
                if self._schedule.at(step) < GROW_UNTIL:
                    self._grow()
                self._cull()
                self._forget()
            if self._schedule.resets(step):
                self._raw("opacities").clamp_(max=float(np.log(RESET_OPACITY / (1 - RESET_OPACITY))))
                for moment in ("exp_avg", "exp_avg_sq"):
                    self._adam.state[self._raw("opacities")][moment].zero_()

    def _raw(self, name: str) -> Tensor:
        return next(group["params"][0] for group in self._adam.param_groups if group["name"] == name)

    def _forget(self) -> None:
        self._moved, self._seen = torch.zeros(len(self)), torch.zeros(len(self))

    def _remember(self, view: View, size: tuple[int, int]) -> None:
        """Add up how far the projected means would move: by x, the gradient by x [m] times z / fx."""
        means = self._raw("means")
        assert means.grad is not None
        rotation, translation = view.viewmat[:3, :3], view.viewmat[:3, 3]
        depth = (means.detach() @ rotation.T + translation)[:, 2:]
        pixels = (means.grad @ rotation.T)[:, :2] * depth / torch.tensor(view.intrinsics[:2])
        self._moved += (pixels * torch.tensor(size) / 2).norm(dim=1)
        self._seen += (means.grad != 0).any(1)

    def _grow(self) -> None:
        """What moves far is doubled where it is small, else split."""
        grows = self._moved / self._seen.clamp_min(1) > GROWTH_GRADIENT
        large = self._raw("scales").exp().amax(1) > GROWTH_SCALE * self._radius
        double, split = (torch.nonzero(grows & which)[:, 0] for which in (~large, large))
        count = len(self)
        self._take(torch.cat([torch.arange(count), double, split, split]), fresh_from=count)
        halves = torch.arange(len(self) - 2 * len(split), len(self))
        offsets = torch.randn(len(halves), 3, generator=self._random) * self._raw("scales")[halves].exp()
        self._raw("means")[halves] += (_rotations(self._raw("quats")[halves]) @ offsets[..., None])[..., 0]
        self._raw("scales")[torch.cat([split, halves])] -= float(np.log(SPLIT))

    def _cull(self) -> None:
        means = self._raw("means")
        inside = ((means >= self._bounds[0]) & (means <= self._bounds[1])).all(1)
        kept = torch.nonzero(inside & (self._raw("opacities").sigmoid() > CULL_OPACITY))[:, 0]
        self._take(kept, fresh_from=len(kept))

    def _take(self, index: Tensor, fresh_from: int) -> None:
        """These rows of everything; Adam knows nothing of those from ``fresh_from`` on."""
        for group in self._adam.param_groups:
            old = group["params"][0]
            state = self._adam.state.pop(old, None)
            new = old.detach()[index].requires_grad_()
            group["params"] = [new]
            if state is not None:
                for moment in ("exp_avg", "exp_avg_sq"):
                    state[moment] = state[moment][index]
                    state[moment][fresh_from:] = 0
                self._adam.state[new] = state


def _body(points: VehiclePoints, seed: int) -> Gaussians:
    """Some of the points, round, as large as their three neighbours are far, turned anyhow."""
    random = np.random.default_rng(seed)
    chosen = random.permutation(len(points.points))[:POINTS]
    means, count = points.points[chosen], len(chosen)
    distances = KDTree(means).query(means, min(4, count))[0].reshape(count, -1)[:, 1:]
    radii = np.maximum(distances.mean(1) if distances.size else np.full(count, THINNEST), THINNEST)
    quats = random.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Gaussians(
        means.astype(np.float32),
        quats.astype(np.float32),
        np.repeat(radii[:, None], 3, 1).astype(np.float32),
        np.full(count, OPACITY, np.float32),
        ((points.colors[chosen] / 255 - 0.5) / SH_C0).astype(np.float32)[:, None],
    )


def _rotations(quats: Tensor) -> Tensor:
    """[N, 3, 3] of [N, 4] wxyz of any length."""
    w, x, y, z = torch.nn.functional.normalize(quats).unbind(1)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return torch.stack(rows, 1).view(-1, 3, 3)
