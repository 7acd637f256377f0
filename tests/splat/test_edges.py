"""Clouds and images at the edge of what there is."""

from dataclasses import replace

import pytest
import torch

from dwgs.scene import InputError
from dwgs.splat import Splats, View, project, reference, render
from dwgs.splat.constants import MAX_TANGENT, NEAR

FIELDS = ("means", "quats", "scales", "opacities", "sh")


def test_empty_cloud_is_black_and_transparent(make_cloud, make_view):
    rendering = render(make_cloud(n=0), make_view())
    assert rendering.rgb.abs().max() == 0
    assert rendering.alpha.max() == 0


def test_empty_cloud_has_a_gradient(make_cloud, make_view, leaves):
    splats, view = make_cloud(n=0), make_view()
    tensors = leaves(splats, view)
    v = torch.autograd.grad(render(splats, view).rgb.sum(), tensors)
    assert v[0].shape == (0, 3)
    assert v[-1].abs().max() == 0


def test_what_lies_behind_the_camera_is_not_drawn(make_cloud, make_view, leaves):
    splats, view = make_cloud(), make_view()
    viewmat = view.viewmat.clone()
    viewmat[2, 3] = -20
    behind = replace(view, viewmat=viewmat)
    tensors = leaves(splats, behind)
    rendering = render(splats, behind)
    assert rendering.alpha.max() == 0
    assert all(v.abs().max() == 0 for v in torch.autograd.grad(rendering.rgb.sum(), tensors))


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("field", FIELDS)
def test_gaussians_that_are_not_finite_are_not_drawn(make_cloud, make_view, leaves, field, value):
    splats, view = make_cloud(n=200), make_view()
    broken = replace(splats, **{field: getattr(splats, field).clone()})
    getattr(broken, field).view(200, -1)[::4, 0] = value
    kept = torch.arange(200) % 4 != 0
    rest = Splats(*(getattr(splats, f)[kept] for f in FIELDS))
    tensors = leaves(broken, view)
    rendering = render(broken, view)
    assert torch.equal(rendering.rgb, render(rest, view).rgb)
    for v in torch.autograd.grad(rendering.rgb.sum(), tensors):
        assert v.isfinite().all()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 40), (33, 1), (16, 16), (17, 15)])
def test_images_of_any_size_equal_the_reference(make_cloud, make_view, leaves, gradients, width, height):
    splats, view = make_cloud(n=100), make_view()
    view = replace(view, width=width, height=height, intrinsics=(30.0, 30.0, width / 2, height / 2))
    tensors = leaves(splats, view)
    inside = (~reference.borderline(splats, view)).float()
    ours, theirs = render(splats, view), reference.render(splats, view)
    assert ours.rgb.shape == (height, width, 3)
    assert ((ours.rgb - theirs.rgb).abs() * inside[..., None]).max() < 5e-6
    for a, b in zip(gradients(ours, tensors, inside), gradients(theirs, tensors, inside), strict=True):
        assert (a - b).norm() <= 2e-5 * b.norm() + 1e-6


def test_views_wider_than_the_affine_bound_equal_the_reference(make_cloud, make_view, leaves, gradients):
    splats, view = make_cloud(n=100), make_view(width=80, height=60)
    near = view.viewmat.clone()
    near[2, 3] = 2.0
    view = replace(view, viewmat=near, intrinsics=(20.0, 20.0, 40.0, 30.0))
    points = splats.means @ near[:3, :3].T + near[:3, 3]
    assert ((points[:, :2] / points[:, 2:]).abs() > MAX_TANGENT)[points[:, 2] > NEAR].any()
    tensors = leaves(splats, view)
    inside = (~reference.borderline(splats, view)).float()
    ours, theirs = render(splats, view), reference.render(splats, view)
    assert ((ours.rgb - theirs.rgb).abs() * inside[..., None]).max() < 5e-6
    for a, b in zip(gradients(ours, tensors, inside), gradients(theirs, tensors, inside), strict=True):
        assert (a - b).norm() <= 2e-5 * b.norm()


def test_one_gaussian_can_cover_everything(make_view):
    view = make_view()
    center = -view.viewmat[:3, :3].T @ (view.viewmat[:3, 3] - torch.tensor([0.0, 0.0, 3.0]))
    splats = Splats(center[None], torch.eye(4)[:1], torch.full((1, 3), 500.0), torch.tensor([0.6]), torch.ones(1, 1, 3))
    assert torch.allclose(render(splats, view).alpha, torch.tensor(0.6), atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_scales_from_needles_to_planets_equal_the_reference(make_cloud, make_view, leaves, seed):
    splats, view = make_cloud(n=30, seed=seed), make_view()
    random = torch.Generator().manual_seed(seed)
    splats = replace(splats, scales=10 ** (12 * torch.rand(30, 3, generator=random) - 8))
    tensors = leaves(splats, view)
    inside = ~reference.borderline(splats, view)
    ours, theirs = render(splats, view), reference.render(splats, view)
    # the exponent is a small difference of large numbers along a needle: worst seen 2e-4
    assert ((ours.rgb - theirs.rgb).abs().amax(-1) * inside).max() < 2e-3
    for v in torch.autograd.grad(ours.rgb.sum() + ours.depth.sum(), tensors):
        assert v.isfinite().all()


def test_radii_reach_to_the_cut_and_no_further(make_cloud, make_view):
    splats, view = make_cloud(n=50), make_view(width=400, height=300)
    for k in range(0, 50, 7):
        one = Splats(*(getattr(splats, f)[k : k + 1] for f in FIELDS))
        projected = project(one, view)
        (x, y), (extent_x, extent_y) = projected.means2d[0].tolist(), projected.radii[0].tolist()
        rows, columns = render(one, view).alpha.nonzero().unbind(1)
        if len(rows) and bool(projected.visible[0]):
            assert extent_x - 2 < (columns + 0.5 - x).abs().max() <= extent_x + 1e-3
            assert extent_y - 2 < (rows + 0.5 - y).abs().max() <= extent_y + 1e-3


def test_wrong_shapes_are_named():
    with pytest.raises(InputError, match=r"Splats.quats has shape \(5, 4\), got \(5, 3\)"):
        Splats(torch.zeros(5, 3), torch.zeros(5, 3), torch.zeros(5, 3), torch.zeros(5), torch.zeros(5, 1, 3))


def test_tensors_of_another_type_are_refused(make_cloud, make_view):
    splats = make_cloud(n=3)
    with pytest.raises(InputError, match=r"float32 on one device, got torch\.float64"):
        render(replace(splats, means=splats.means.double()), make_view())


def test_expected_depth_is_the_mean_of_what_is_seen():
    view = View(torch.eye(4), (50.0, 50.0, 10.0, 10.0), 20, 20)
    quats, opacities = torch.eye(4)[:1], torch.tensor([0.5])
    splats = Splats(torch.tensor([[0.0, 0.0, 4.0]]), quats, torch.ones(1, 3), opacities, torch.ones(1, 1, 3))
    assert torch.allclose(render(splats, view).expected_depth, torch.tensor(4.0))
