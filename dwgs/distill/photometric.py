"""How a drawing differs from its frame, and the gradient of that."""

from typing import Protocol

import torch

from dwgs.distill.config import Recipe
from dwgs.distill.shots import Shot
from dwgs.optimize import RetainedMse, dssim, weighted_l1, weighted_mse
from dwgs.splat import Drawing

DSSIM_SHARE = 0.2
"""Of the robust loss."""


class Photometric(Protocol):
    """The loss on colour of one drawing, as it is drawn again and again."""

    def __call__(self) -> float:
        """The loss; its gradient is left in the drawing."""
        ...


def photometric(drawing: Drawing, shot: Shot, recipe: Recipe) -> Photometric:
    """L1 with D-SSIM if the recipe is robust, else squared error."""
    if recipe.robust or shot.frozen.has_gain:
        return _ByAutograd(drawing, shot, recipe.robust)
    return RetainedMse(drawing.rgb, shot.target, shot.weight, drawing.v_rgb)


class _ByAutograd:
    def __init__(self, drawing: Drawing, shot: Shot, robust: bool) -> None:
        self._drawing, self._shot, self._robust = drawing, shot, robust

    def __call__(self) -> float:
        target, weight = self._shot.target, self._shot.weight
        drawn = self._drawing.rgb.detach().requires_grad_()
        rgb = self._shot.frozen.exposed(drawn)
        if self._robust:
            l1 = weighted_l1(rgb, target, weight)
            loss = (1 - DSSIM_SHARE) * l1 + DSSIM_SHARE * dssim(rgb, target, weight)
        else:
            loss = weighted_mse(rgb, target, weight)
        self._drawing.v_rgb.copy_(torch.autograd.grad(loss, drawn)[0])
        return loss.item()
