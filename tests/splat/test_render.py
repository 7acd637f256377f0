"""The kernels against the specification, and what must not change an image."""

from dataclasses import fields, replace

import pytest
import torch
from torch import Tensor

from dwgs.splat import Rendering, Splats, View, reference, render

IMAGE_TOLERANCE = 5e-6
"""Worst seen 1.6e-6: float32, and an exponential good to 1e-6."""
DEPTH_TOLERANCE = 5e-5
"""The same in metres, at depths around 6 m; worst seen 1.1e-5."""
GRADIENT_TOLERANCE = 1e-5
"""Relative L2; worst seen 2.7e-6, by the camera pose."""


def leaves(splats: Splats, view: View) -> list[Tensor]:
    """Every tensor that can take a gradient, made to require one."""
    return [t.requires_grad_() for t in (*(getattr(splats, f.name) for f in fields(Splats)), view.viewmat)]


def gradients(rendering: Rendering, tensors: list[Tensor], weight: Tensor) -> tuple[Tensor, ...]:
    """Of a loss that looks at every output with random weights, nowhere where ``weight`` [H, W] is 0."""
    random = torch.Generator().manual_seed(7)
    outputs = (rendering.rgb, rendering.depth[..., None], rendering.alpha[..., None])
    losses = [(o * torch.randn(o.shape, generator=random) * weight[..., None]).sum() for o in outputs]
    return torch.autograd.grad(torch.stack(losses).sum(), tensors)


def relative(a: Tensor, b: Tensor) -> float:
    return ((a - b).norm() / b.norm()).item()


@pytest.mark.parametrize("sh_count", [1, 4, 9, 16])
def test_image_and_gradients_equal_the_reference(make_cloud, make_view, sh_count):
    splats, view = make_cloud(sh_count=sh_count), make_view()
    tensors = leaves(splats, view)
    borderline = reference.borderline(splats, view)
    assert borderline.float().mean() < 0.01
    inside = (~borderline).float()

    ours, theirs = render(splats, view), reference.render(splats, view)
    assert ((ours.rgb - theirs.rgb).abs() * inside[..., None]).max() < IMAGE_TOLERANCE
    assert ((ours.alpha - theirs.alpha).abs() * inside).max() < IMAGE_TOLERANCE
    assert ((ours.depth - theirs.depth).abs() * inside).max() < DEPTH_TOLERANCE
    for a, b in zip(gradients(ours, tensors, inside), gradients(theirs, tensors, inside), strict=True):
        assert relative(a, b) < GRADIENT_TOLERANCE


def test_one_and_two_threads_give_the_same_bits(make_cloud, make_view):
    splats, view = make_cloud(n=3000), make_view(width=200, height=150)
    tensors = leaves(splats, view)
    everywhere = torch.ones(view.height, view.width)
    one, two = render(splats, view, threads=1), render(splats, view, threads=2)
    for name in ("rgb", "depth", "alpha"):
        assert torch.equal(getattr(one, name), getattr(two, name))
    for a, b in zip(gradients(one, tensors, everywhere), gradients(two, tensors, everywhere), strict=True):
        assert torch.equal(a, b)


def test_the_order_of_gaussians_changes_nothing(make_cloud, make_view):
    splats, view = make_cloud(), make_view()
    order = torch.randperm(len(splats), generator=torch.Generator().manual_seed(1))
    shuffled = Splats(*(getattr(splats, f.name)[order] for f in fields(Splats)))
    assert torch.equal(render(splats, view).rgb, render(shuffled, view).rgb)


def test_empty_cloud_is_black_and_transparent(make_cloud, make_view):
    rendering = render(make_cloud(n=0), make_view())
    assert rendering.rgb.abs().max() == 0
    assert rendering.alpha.max() == 0


def test_gaussians_that_are_not_finite_are_not_drawn(make_cloud, make_view):
    splats, view = make_cloud(n=200), make_view()
    broken = replace(splats, means=splats.means.clone())
    broken.means[::4] = torch.nan
    kept = torch.arange(200) % 4 != 0
    rest = Splats(*(getattr(splats, f.name)[kept] for f in fields(Splats)))
    assert torch.equal(render(broken, view).rgb, render(rest, view).rgb)
