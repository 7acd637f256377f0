"""Compositing as torch does it best: tile by tile an alpha for every Gaussian and pixel, and a cumulative product."""

import torch
from torch import Tensor

from dwgs.splat import View
from dwgs.splat.constants import MAX_ALPHA, MIN_ALPHA, STOP_TRANSMITTANCE, TILE
from dwgs.splat.ops.binned import Binned


def composite(records: Tensor, binned: Binned, view: View) -> Tensor:
    """Image [5, H', W'] of whole tiles (r, g, b, depth, alpha) of records [N, 16]; autograd knows its gradient."""
    across, down = view.tiles
    gaussian_from_sorted = binned.gaussian_from_isect[binned.isect_from_sorted]
    counts = (binned.ranges[:, 1] - binned.ranges[:, 0]).tolist()
    rows = records[gaussian_from_sorted].split(counts)
    steps = torch.arange(TILE) + 0.5
    pixels = torch.stack([steps.repeat(TILE), steps.repeat_interleave(TILE)])  # x, y of the first tile
    corners = [torch.tensor([[k % across], [k // across]]) * TILE for k in range(across * down)]
    tiles = [_tile(r, pixels + corner) for r, corner in zip(rows, corners, strict=True)]
    grid = torch.stack(tiles).view(down, across, 5, TILE, TILE)
    return grid.permute(2, 0, 3, 1, 4).reshape(5, down * TILE, across * TILE)


def _tile(records: Tensor, pixels: Tensor) -> Tensor:
    """[5, P] of records [n, 16], nearest first, at pixels [2, P]."""
    if len(records) == 0:
        return records.new_zeros(5, pixels.shape[1])
    x, y, xx, xy, yy, opacity = records[:, :6, None].unbind(1)
    dx, dy = pixels[0] - x, pixels[1] - y
    power = -0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy
    alpha = (opacity * power.exp()).clamp_max(MAX_ALPHA)
    alpha = alpha * (alpha >= MIN_ALPHA)
    after = (1 - alpha).cumprod(0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    weights = before * alpha * (before >= STOP_TRANSMITTANCE)
    return torch.cat([records[:, 6:10].T @ weights, weights.sum(0)[None]])
