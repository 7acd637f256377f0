"""The field's standard on a GPU (Ye et al. 2024), where it is installed: the same scene, the same outputs."""

from dataclasses import fields

import gsplat
import torch
from torch import Tensor

from dwgs.splat import Splats, View
from dwgs.splat.constants import NEAR


class Gsplat:
    """Renders ``splats`` and trains them, eagerly as its users do, with torch's fused Adam."""

    def __init__(self, splats: Splats, view: View) -> None:
        self.inputs = [getattr(splats, f.name).detach().clone().requires_grad_() for f in fields(Splats)]
        fx, fy, cx, cy = view.intrinsics
        K = torch.tensor([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], device=view.viewmat.device)
        self._camera = {"viewmats": view.viewmat[None], "Ks": K[None], "width": view.width, "height": view.height}
        self._degree = round(splats.sh.shape[1] ** 0.5) - 1
        self._adam = torch.optim.Adam(self.inputs, lr=1e-4, fused=True)

    def render(self) -> tuple[Tensor, Tensor, Tensor]:
        """rgb [H, W, 3], depth [H, W], alpha [H, W]."""
        images, alpha, _ = gsplat.rasterization(
            *self.inputs, **self._camera, sh_degree=self._degree, near_plane=NEAR, packed=False, render_mode="RGB+D"
        )
        return images[0, ..., :3], images[0, ..., 3], alpha[0, ..., 0]

    def train(self, target: Tensor) -> None:
        """One step towards the ``target`` [H, W, 3]."""
        (self.render()[0] - target).square().mean().backward()
        self._adam.step()
        self._adam.zero_grad()
