"""Small random clouds and views that every splat test looks at."""

from collections.abc import Callable

import pytest
import torch

from dwgs.splat import Splats, View


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
    """Views of the origin from 6 m away, turned at random."""

    def view(width: int = 100, height: int = 75, seed: int = 0) -> View:
        random = torch.Generator().manual_seed(seed)
        rotation, _ = torch.linalg.qr(torch.randn(3, 3, generator=random, dtype=torch.float64))
        viewmat = torch.eye(4)
        viewmat[:3, :3] = rotation * torch.linalg.det(rotation).sign()
        viewmat[:3, 3] = torch.tensor([0.2, -0.1, 6.0])
        return View(viewmat, (0.9 * width, 0.95 * width, 0.49 * width, 0.51 * height), width, height)

    return view
