"""The specification: the same image in plain torch, dense, float64, differentiated by autograd.

Every Gaussian meets every pixel, so memory grows with N x H x W. Only the rules are shared with the kernels.
"""

from dataclasses import fields

import torch
from torch import Tensor

from dwgs.splat.constants import (
    LOW_PASS,
    MAX_ALPHA,
    MAX_TANGENT,
    MIN_ALPHA,
    NEAR,
    SH_C0,
    SH_C1,
    SH_C2,
    SH_C3,
    STOP_TRANSMITTANCE,
)
from dwgs.splat.splats import Layers, Objects, Rendering, Splats, View


def render(
    splats: Splats,
    view: View,
    layers: Layers | None = None,
    objects: Objects | None = None,
    antialiased: bool = False,
    features: Tensor | None = None,
) -> Rendering:
    """What `dwgs.splat.render` approximates, for one view; tensors of any float type in, float64 out."""
    if features is None:
        features = splats.means.new_zeros(len(splats), 0)
    records, index = project(splats, view, objects, antialiased)
    alphas, colors = _alphas(records, view), torch.cat([records[:, 6:], features.double()[index]], 1)
    alphas = alphas * (alphas >= MIN_ALPHA)
    start = layers.front_transmittance.double() if layers else alphas.new_ones(alphas.shape[1:])
    before, end = _transmittances(alphas, start)
    weights = before * alphas * (before >= STOP_TRANSMITTANCE)
    image = torch.einsum("nhw,nc->hwc", weights, colors)
    rgb, depth, alpha = image[..., :3], image[..., 3], 1 - end
    if layers:
        rgb = layers.front_rgb + rgb + end[..., None] * layers.back_rgb
        depth = layers.front_depth + depth + end * layers.back_depth
        alpha = 1 - end * (1 - layers.back_alpha)
    return Rendering(rgb, depth, alpha, image[..., 4:], torch.tensor(0))


def borderline(
    splats: Splats,
    view: View,
    layers: Layers | None = None,
    objects: Objects | None = None,
    antialiased: bool = False,
    margin: float = 1e-3,
) -> Tensor:
    """[H, W] whether a Gaussian comes within a relative ``margin`` of a switching rule: cut, clamp or stop.

    There the image or its gradient jumps, and float32 may fall on the other side.
    """
    alphas = _alphas(project(splats, view, objects, antialiased)[0], view)
    start = layers.front_transmittance.double() if layers else alphas.new_ones(alphas.shape[1:])
    before, _ = _transmittances(alphas * (alphas >= MIN_ALPHA), start)
    near_rule = [(alphas / MIN_ALPHA - 1).abs() < margin, (before / STOP_TRANSMITTANCE - 1).abs() < margin]
    unclamped = alphas >= MAX_ALPHA * (1 - margin)
    return (near_rule[0] | near_rule[1] | unclamped).any(0)


def _transmittances(alphas: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Transmittance before each Gaussian [N, H, W], and behind the last one drawn [H, W]."""
    before, light = [], start
    for alpha in alphas:
        before.append(light)
        light = torch.where(light >= STOP_TRANSMITTANCE, light * (1 - alpha), light)
    return torch.stack(before) if before else alphas, light


def project(
    splats: Splats, view: View, objects: Objects | None = None, antialiased: bool = False
) -> tuple[Tensor, Tensor]:
    """Records [D, 10] of drawable Gaussians, nearest first, as in `Projected.records`; and which they are [D]."""
    means, quats, scales, opacities, sh = (getattr(splats, f.name).double() for f in fields(splats))
    viewmats = view.viewmat.double().expand(len(means), 4, 4)
    if objects is not None:
        owner = torch.arange(len(objects.counts)).repeat_interleave(torch.tensor(objects.counts))
        viewmats = viewmats @ objects.world_from_object.double()[owner]
    R, t = viewmats[:, :3, :3], viewmats[:, :3, 3]
    points = torch.einsum("nij,nj->ni", R, means) + t
    finite = torch.stack([x.flatten(1).isfinite().all(1) for x in (means, quats, scales, opacities[:, None], sh)])
    drawn = (finite.all(0) & (points[:, 2] > NEAR) & (opacities > MIN_ALPHA)).nonzero()[:, 0]
    index = drawn[points[drawn, 2].argsort(stable=True)]
    means, quats, scales, opacities, sh, points, R, t = (
        x[index] for x in (means, quats, scales, opacities, sh, points, R, t)
    )

    fx, fy, cx, cy = view.lenses[0].tolist()
    x, y, z = points.unbind(1)
    zero = torch.zeros_like(z)
    u, v = (x / z).clamp(-MAX_TANGENT, MAX_TANGENT), (y / z).clamp(-MAX_TANGENT, MAX_TANGENT)
    J = torch.stack([fx / z, zero, -fx * u / z, zero, fy / z, -fy * v / z], 1).view(-1, 2, 3)
    M = J @ R @ _rotation(quats) * scales[:, None]
    sharp = M @ M.mT
    covariances = sharp + LOW_PASS * torch.eye(2, dtype=M.dtype)
    if antialiased:
        opacities = opacities * (sharp.det() / covariances.det()).clamp_min(1e-12).sqrt()
    conics = covariances.inverse()

    rays = means + torch.einsum("nij,ni->nj", R, t)
    directions = rays / rays.norm(dim=1, keepdim=True)
    basis = _sh_basis(directions)[:, : sh.shape[1]]
    colors = (0.5 + torch.einsum("nk,nkc->nc", basis, sh)).clamp_min(0)
    columns = [fx * x / z + cx, fy * y / z + cy, conics[:, 0, 0], conics[:, 0, 1], conics[:, 1, 1], opacities]
    return torch.cat([torch.stack(columns, 1), colors, z[:, None]], 1), index


def _alphas(records: Tensor, view: View) -> Tensor:
    """[D, H, W] of records [D, 10], clamped but not cut."""
    rows = torch.arange(view.height, dtype=records.dtype) + 0.5
    columns = torch.arange(view.width, dtype=records.dtype) + 0.5
    x, y, xx, xy, yy, opacity = (field[:, None, None] for field in records[:, :6].unbind(1))
    dx, dy = columns - x, rows[:, None] - y
    return (opacity * (-0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy).exp()).clamp_max(MAX_ALPHA)


def _rotation(quats: Tensor) -> Tensor:
    """[N, 3, 3] from wxyz [N, 4] of any length."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
    ]
    return torch.stack(rows, 1)


def _sh_basis(directions: Tensor) -> Tensor:
    """[N, 16] real spherical harmonics of unit directions [N, 3]."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    a, b, c = SH_C2
    d, e, f, g, h = SH_C3
    basis = [
        torch.full_like(x, SH_C0),
        -SH_C1 * y,
        SH_C1 * z,
        -SH_C1 * x,
        a * x * y,
        -a * y * z,
        b * (2 * zz - xx - yy),
        -a * x * z,
        c * (xx - yy),
        -d * y * (3 * xx - yy),
        e * x * y * z,
        -f * y * (4 * zz - xx - yy),
        g * z * (2 * zz - 3 * xx - 3 * yy),
        -f * x * (4 * zz - xx - yy),
        h * z * (xx - yy),
        -d * x * (xx - 3 * yy),
    ]
    return torch.stack(basis, 1)
