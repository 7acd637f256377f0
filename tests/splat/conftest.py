"""Small random clouds and views that every splat test looks at."""

from collections.abc import Callable
from dataclasses import fields

import pytest
import torch
from torch import Tensor

from dwgs.splat import Rendering, Splats, View
from dwgs.splat.kernels import composite_cuda
from dwgs.splat.ops import composite


@pytest.fixture
def make_cloud() -> Callable[..., Splats]:
    """Clouds of ``n`` Gaussians around the origin, a few metres across."""

    def cloud(n: int = 300, sh_count: int = 16, seed: int = 0) -> Splats:
        random = torch.Generator().manual_seed(seed)
        normal = lambda *shape: torch.randn(*shape, generator=random)  # noqa: E731
        return Splats(
            means=normal(n, 3) * torch.tensor([1.5, 1.0, 1.0]),
            quats=normal(n, 4),
            scales=0.15 * torch.exp(0.5 * normal(n, 3)),
            opacities=torch.sigmoid(normal(n)),
            sh=0.3 * normal(n, sh_count, 3),
        )

    return cloud


@pytest.fixture
def make_view() -> Callable[..., View]:
    """Views of the origin from 6 m away, turned at random; sizes are not whole tiles."""

    def view(width: int = 100, height: int = 75, seed: int = 0) -> View:
        random = torch.Generator().manual_seed(seed)
        rotation, _ = torch.linalg.qr(torch.randn(3, 3, generator=random, dtype=torch.float64))
        viewmat = torch.eye(4)
        viewmat[:3, :3] = rotation * torch.linalg.det(rotation).sign()
        viewmat[:3, 3] = torch.tensor([0.2, -0.1, 6.0])
        return View(viewmat, (0.9 * width, 0.95 * width, 0.49 * width, 0.51 * height), width, height)

    return view


@pytest.fixture
def as_on_gpu(monkeypatch) -> None:
    """Bin and composite as on a GPU; each pixel is a block and a warp of its own."""
    monkeypatch.setitem(composite.WAYS, "cpu", composite.WAYS["cuda"])
    monkeypatch.setattr(composite_cuda, "PARTS", composite_cuda.BLOCK)
    monkeypatch.setattr(composite_cuda, "FEATURE_PARTS", composite_cuda.BLOCK)


@pytest.fixture
def leaves() -> Callable[..., list[Tensor]]:
    """Every tensor of splats (and of a view) that can take a gradient, made to require one."""

    def leaves_of(splats: Splats, view: View | None = None) -> list[Tensor]:
        tensors = [getattr(splats, f.name) for f in fields(Splats)]
        return [t.requires_grad_() for t in (tensors if view is None else [*tensors, view.viewmat])]

    return leaves_of


@pytest.fixture
def gradients() -> Callable[..., tuple[Tensor, ...]]:
    """Of a loss that looks at every output with random weights, and nowhere where ``weight`` [H, W] is 0."""

    def gradients_of(rendering: Rendering, tensors: list[Tensor], weight: Tensor | float = 1.0):
        random = torch.Generator().manual_seed(7)
        outputs = (rendering.rgb.movedim(-1, 0), rendering.depth, rendering.alpha)
        losses = [(o * torch.randn(o.shape, generator=random) * weight).sum() for o in outputs]
        return torch.autograd.grad(torch.stack(losses).sum(), tensors)

    return gradients_of
