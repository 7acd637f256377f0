"""Thousands of random scenes, many of them absurd, against the specification."""

from dataclasses import replace

import pytest
import torch

from dwgs.splat import Splats, View, project, reference, render

SCENES = 500
"""Per seed."""


def scene(random: torch.Generator) -> tuple[Splats, View]:
    """A few Gaussians and a view: sizes, poses, scales over twelve orders of magnitude, opacities 0 and 1."""

    def draw(*shape):
        return torch.rand(*shape, generator=random)

    n, width, height = (int(x) for x in torch.randint(1, 40, (3,), generator=random))
    n = n // 4
    spread = 10 ** (3 * draw(1) - 2)
    exponents = draw(n, 3) * 12 - 8 if draw(1) < 0.3 else draw(n, 3) * 2 - 2
    rotation, _ = torch.linalg.qr(torch.randn(3, 3, generator=random, dtype=torch.float64))
    viewmat = torch.eye(4)
    viewmat[:3, :3] = rotation * torch.linalg.det(rotation).sign()
    viewmat[:3, 3] = torch.randn(3, generator=random) * torch.tensor([1.0, 1.0, 3.0]) + torch.tensor([0, 0, 4.0])
    focal = 10 ** (1 + draw(1).item())
    view = View(viewmat, (focal, 1.1 * focal, width / 2 + 3 * draw(1).item(), height / 2), width, height)
    opacities = draw(n).where(draw(n) > 0.2, draw(n).round())
    sh = torch.randn(n, (1, 4, 9, 16)[int(4 * draw(1))], 3, generator=random)
    splats = Splats(spread * torch.randn(n, 3, generator=random), torch.randn(n, 4, generator=random), 10**exponents,
                    opacities, sh)  # fmt: skip
    return splats, view


@pytest.mark.parametrize("seed", range(4))
def test_random_scenes_equal_the_reference_and_poison_nothing(seed):
    random = torch.Generator().manual_seed(seed)
    compared = 0
    for _ in range(SCENES):
        splats, view = scene(random)
        tensors = [getattr(splats, name).requires_grad_() for name in Splats.__dataclass_fields__]
        antialiased = bool(torch.rand(1, generator=random) < 0.3)
        ours = render(splats, view, antialiased=antialiased, threads=1)
        theirs = reference.render(splats, view, antialiased=antialiased)
        inside = ~reference.borderline(splats, view, antialiased=antialiased, margin=2e-3)
        # along a needle the exponent is a small difference of large numbers
        tolerance = 2e-5 if splats.scales.numel() == 0 or splats.scales.max() < 10 * splats.scales.min() else 2e-3
        scale = max(1.0, float(theirs.rgb.detach().abs().max()))
        assert ((ours.rgb - theirs.rgb).abs().amax(-1) * inside).max() < tolerance * scale
        assert ((ours.alpha - theirs.alpha).abs() * inside).max() < tolerance
        for v in torch.autograd.grad(ours.rgb.sum() + ours.depth.sum() + ours.alpha.sum(), tensors):
            assert v.isfinite().all()
        compared += int(inside.sum())
    assert compared > 100 * SCENES


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_one_broken_gaussian_is_dropped_counted_and_nothing_else(make_cloud, make_view, value):
    view, random = make_view(), torch.Generator().manual_seed(3)
    for name in Splats.__dataclass_fields__:
        splats = make_cloud(n=60)
        drawn = project(splats, view).visible.nonzero()[:, 0]
        victim = int(drawn[torch.randint(len(drawn), (1,), generator=random)])
        values = getattr(splats, name).clone()
        values[victim].view(-1)[0] = value
        projected = project(replace(splats, **{name: values}), view)
        assert projected.broken.nonzero().tolist() == [[victim]]
        assert not projected.visible[victim]
        assert projected.visible.sum() == len(drawn) - 1
    assert not project(make_cloud(), view).broken.any()
