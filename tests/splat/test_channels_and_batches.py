"""Feature channels beside the colours, and several views at once."""

from dataclasses import replace

import pytest
import torch

from dwgs.scene import InputError
from dwgs.splat import Layers, Rendering, View, composite, project, reference, render


def weighted(rendering: Rendering) -> torch.Tensor:
    """A loss that looks at every image, differently at every pixel."""
    random = torch.Generator().manual_seed(7)
    outputs = (rendering.rgb, rendering.depth, rendering.alpha, rendering.features)
    return sum((o * torch.randn(o.shape, generator=random)).sum() for o in outputs)


@pytest.mark.parametrize("count", [1, 3, 20])
def test_features_and_their_gradients_equal_the_reference(make_cloud, make_view, leaves, count):
    splats, view = make_cloud(sh_count=1), make_view()
    features = torch.randn(len(splats), count, generator=torch.Generator().manual_seed(1))
    tensors = [features.requires_grad_(), *leaves(splats, view)]
    inside = (~reference.borderline(splats, view)).float()
    shown = []
    for rendering in (render(splats, view, features=features), reference.render(splats, view, features=features)):
        masked = Rendering(
            rendering.rgb * inside[..., None],
            rendering.depth * inside,
            rendering.alpha * inside,
            rendering.features * inside[..., None],
            rendering.intersections,
        )
        shown.append((masked, torch.autograd.grad(weighted(masked), tensors)))
    (ours, v_ours), (theirs, v_theirs) = shown
    assert (ours.features - theirs.features).abs().max() < 1e-5
    for a, b in zip(v_ours, v_theirs, strict=True):
        assert (a - b).norm() < 2e-6 * b.norm()


def test_features_change_no_colour(make_cloud, make_view):
    splats, view = make_cloud(), make_view()
    features = torch.ones(len(splats), 2)
    plain, rich = render(splats, view), render(splats, view, features=features)
    assert plain.features.shape == (75, 100, 0)
    assert torch.equal(plain.rgb, rich.rgb)
    assert torch.allclose(rich.features, rich.alpha[..., None].expand(-1, -1, 2), atol=1e-6)


def test_features_follow_their_gaussians_through_several_records(make_cloud, make_view):
    view = make_view()
    near, far = project(make_cloud(seed=1), view), project(make_cloud(seed=2), view)
    features = torch.randn(600, 2)
    swapped = composite([far, near], view, features=torch.cat([features[300:], features[:300]]))
    assert torch.allclose(composite([near, far], view, features=features).features, swapped.features, atol=1e-6)


def test_features_need_a_row_for_every_gaussian(make_cloud, make_view):
    with pytest.raises(InputError, match=r"features are float32 \[300, F\]"):
        render(make_cloud(), make_view(), features=torch.zeros(299, 1))


def test_a_batch_is_its_views(make_cloud, make_view, leaves):
    splats, views = make_cloud(), [make_view(seed=seed) for seed in range(3)]
    views[1] = replace(views[1], intrinsics=(70.0, 80.0, 40.0, 30.0))
    features = torch.randn(len(splats), 2).requires_grad_()
    front, back = ([render(make_cloud(n=40, seed=s), v) for v in views] for s in (5, 6))
    layers = [Layers.between(f, b) for f, b in zip(front, back, strict=True)]
    fronts, backs = (torch.stack([getattr(one, name) for one in layers]) for name in ("front", "back"))
    stacked = replace(layers[0], front=fronts, back=backs)
    tensors = [features, *leaves(splats)]
    singles = [render(splats, v, one, features=features) for v, one in zip(views, layers, strict=True)]
    joined = Rendering(*(torch.stack([getattr(s, f) for s in singles]) for f in Rendering.__dataclass_fields__))
    batch = render(splats, View.batch(views), stacked, features=features)
    for name in ("rgb", "depth", "alpha", "features"):
        assert torch.equal(getattr(batch, name), getattr(joined, name))
    v_joined, v_batch = (torch.autograd.grad(weighted(r), tensors) for r in (joined, batch))
    for a, b in zip(v_joined, v_batch, strict=True):
        assert (a - b).norm() < 1e-6 * a.norm()


def test_views_of_a_batch_have_one_size(make_view):
    with pytest.raises(InputError, match="single views of one size"):
        View.batch([make_view(width=20), make_view(width=30)])


@pytest.mark.usefixtures("as_on_gpu")
def test_room_for_intersections_changes_nothing_while_there_is_enough(make_cloud, make_view, leaves):
    splats, view = make_cloud(), make_view()
    tensors = leaves(splats)
    counted = render(splats, view)
    total = int(counted.intersections)
    for capacity in (total, 3 * total):
        roomy = render(splats, view, capacity=capacity)
        assert torch.equal(roomy.rgb, counted.rgb)
        assert int(roomy.intersections) == total
        for a, b in zip(
            *(torch.autograd.grad(weighted(r), tensors) for r in (roomy, render(splats, view))), strict=True
        ):
            assert torch.equal(a, b)


@pytest.mark.usefixtures("as_on_gpu")
def test_too_little_room_is_told_and_harms_nothing(make_cloud, make_view, leaves):
    splats, view = make_cloud(), make_view()
    tensors = leaves(splats)
    total = int(render(splats, view).intersections)
    for capacity in (0, 1, total // 2, total - 1):
        cramped = render(splats, view, capacity=capacity)
        assert int(cramped.intersections) == total > capacity
        assert cramped.rgb.isfinite().all()
        assert all(v.isfinite().all() for v in torch.autograd.grad(weighted(cramped), tensors))
