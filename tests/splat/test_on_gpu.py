"""On a GPU: the same images and gradients as on a CPU, the same bytes every time, and whole steps in a graph."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from dwgs.optimize import Rates, SplatParameters
from dwgs.optimize.losses import weighted_l1, weighted_mse
from dwgs.splat import Layers, Objects, Rendering, Splats, View, capture, project, reference, render
from dwgs.splat.ops.composite import bin

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
]
OUTPUTS = ("rgb", "depth", "alpha", "features")


def moved(splats: Splats, where: str) -> Splats:
    return Splats(*(getattr(splats, f.name).to(where).detach() for f in fields(Splats)))


def seen(view: View, where: str) -> View:
    return replace(view, viewmat=view.viewmat.to(where).detach())


def look(
    splats: Splats, view: View, where: str, weight: Tensor | None = None, **options
) -> tuple[Rendering, tuple[Tensor, ...]]:
    """A rendering there, and gradients of everything by a loss that looks at all of it, by ``weight`` [..., H, W]."""
    splats, view = moved(splats, where), seen(view, where)
    options = {key: value.to(where) if isinstance(value, Tensor) else value for key, value in options.items()}
    tensors = [getattr(splats, f.name) for f in fields(Splats)] + [view.viewmat]
    if "features" in options:
        tensors.append(options["features"])
    if "objects" in options:
        objects = options["objects"]
        options["objects"] = Objects(objects.counts, objects.world_from_object.to(where).detach())
        tensors.append(options["objects"].world_from_object)
    for tensor in tensors:
        tensor.requires_grad_()
    if "layers" in options:
        layers = options["layers"]
        options["layers"] = replace(layers, front=layers.front.to(where), back=layers.back.to(where))
    rendering = render(splats, view, **options)
    random = torch.Generator().manual_seed(7)
    losses = []
    for name in OUTPUTS:
        image = getattr(rendering, name)
        weights = torch.randn(image.shape, generator=random)
        if weight is not None:
            weights *= weight[..., None] if image.ndim > weight.ndim else weight
        losses.append((image * weights.to(where)).sum())
    return rendering, torch.autograd.grad(torch.stack(losses).sum(), tensors)


@pytest.mark.parametrize("what", ["one", "batch", "layers", "features", "objects", "antialiased", "capacity"])
def test_images_and_gradients_equal_those_of_a_cpu(what, make_cloud, make_view):
    splats, options = make_cloud(n=1000), {}
    views = [make_view(width=120, height=90, seed=seed) for seed in range(3)]
    view = View.batch(views) if what == "batch" else views[0]
    if what == "layers":
        options["layers"] = Layers.between(*(render(make_cloud(n=30, seed=s), view) for s in (3, 4)))
    elif what == "features":
        options["features"] = torch.randn(1000, 5, generator=torch.Generator().manual_seed(5))
    elif what == "objects":
        poses = torch.eye(4).repeat(3, 1, 1)
        poses[:, :3, 3] = torch.randn(3, 3, generator=torch.Generator().manual_seed(6))
        options["objects"] = Objects((300, 0, 700), poses)
    elif what == "antialiased":
        options["antialiased"] = True
    elif what == "capacity":
        options["capacity"] = 1_000_000
    known = {key: value for key, value in options.items() if key in ("layers", "objects", "antialiased")}
    jumps = [reference.borderline(splats, each, **known) for each in (views if what == "batch" else [view])]
    inside = (~(torch.stack(jumps) if what == "batch" else jumps[0])).float()
    assert inside.mean() > 0.95
    ours, v_ours = look(splats, view, "cuda", inside, **options)
    theirs, v_theirs = look(splats, view, "cpu", inside, **options)
    assert int(ours.intersections) == int(theirs.intersections)
    for name in OUTPUTS:
        a, b = getattr(ours, name).cpu(), getattr(theirs, name)
        error = (a - b) * (inside[..., None] if a.ndim > inside.ndim else inside)
        assert error.norm() <= 1e-5 * b.norm(), name
    for a, b in zip(v_ours, v_theirs, strict=True):
        assert (a.cpu() - b).norm() <= 1e-5 * b.norm()


def test_the_same_bytes_come_every_time(make_cloud, make_view):
    splats, view = make_cloud(n=5000), make_view(width=300, height=200)
    first, v_first = look(splats, view, "cuda")
    again, v_again = look(splats, view, "cuda")
    assert all(getattr(first, name).equal(getattr(again, name)) for name in OUTPUTS)
    assert all(a.equal(b) for a, b in zip(v_first, v_again, strict=True))


def test_too_little_room_loses_intersections_and_says_so(make_cloud, make_view):
    splats, view = moved(make_cloud(n=500), "cuda"), seen(make_view(), "cuda")
    whole = render(splats, view)
    cut = render(splats, view, capacity=100)
    assert int(cut.intersections) == int(whole.intersections) > 100
    assert cut.rgb.isfinite().all()


def test_degenerate_clouds_are_drawn_as_on_a_cpu(make_cloud, make_view):
    view = make_view(width=33, height=17)
    empty, broken, huge = make_cloud(n=0), make_cloud(n=50), make_cloud(n=50)
    broken.means[3] = torch.nan
    broken.scales[4] = torch.inf
    huge.scales[:10] = 1e4
    huge.scales[10:20] = 1e-8
    for splats in (empty, broken, huge):
        ours, v_ours = look(splats, view, "cuda")
        theirs, v_theirs = look(splats, view, "cpu")
        assert (ours.rgb.cpu() - theirs.rgb).abs().max() < 1e-4
        assert all(v.isfinite().all() for v in v_ours)
        assert all((a.cpu() - b).norm() <= 1e-3 * b.norm() + 1e-6 for a, b in zip(v_ours, v_theirs, strict=True))


def test_crowded_tiles_are_in_order(make_cloud, make_view):
    view, splats = make_view(width=20, height=20), make_cloud(n=20_000)
    records = project(splats, view).records[None]
    ours, theirs = bin(records.cuda(), seen(view, "cuda"), None, 1), bin(records, view, None, 1)
    assert (theirs.ranges[:, 1] - theirs.ranges[:, 0]).max() > 8192
    assert ours.isect_from_sorted.cpu().equal(theirs.isect_from_sorted)
    assert ours.gaussian_from_isect.cpu().equal(theirs.gaussian_from_isect)


@pytest.mark.parametrize("loss", [weighted_l1, weighted_mse])
def test_losses_are_those_of_a_cpu(loss):
    random = torch.Generator().manual_seed(0)
    rgb, target = torch.rand(2, 300, 600, 3, generator=random)
    weight = torch.rand(300, 600, generator=random)
    there, here = rgb.cuda().requires_grad_(), rgb.requires_grad_()
    ours, theirs = loss(there, target.cuda(), weight.cuda()), loss(here, target, weight)
    assert ours.item() == pytest.approx(theirs.item(), rel=1e-5)
    (v_ours,), (v_theirs,) = torch.autograd.grad(3 * ours, there), torch.autograd.grad(3 * theirs, here)
    assert (v_ours.cpu() - v_theirs).norm() < 1e-5 * v_theirs.norm()


def trainable(splats: Splats, where: str) -> SplatParameters:
    rates = Rates(means=1e-3, quats=1e-3, scales=1e-3, opacities=1e-2, sh_dc=1e-2, sh_rest=1e-3)
    rates = replace(rates, stillness=0.1, amplified=("means", "sh"))
    return SplatParameters(splats.to_gaussians(), rates, bounds=np.array([[-3.0] * 3, [3.0] * 3]), device=where)


def train(parameters: SplatParameters, view: View, target: Tensor, factor: float | Tensor = 1.0) -> None:
    rendering = render(parameters.splats(), view, capacity=50_000)
    (rendering.rgb - target).square().sum().backward()
    parameters.step(factor)


def test_a_captured_step_steps_as_an_eager_one(make_cloud, make_view):
    splats, view = make_cloud(n=1000), seen(make_view(), "cuda")
    target = torch.rand(75, 100, 3, generator=torch.Generator().manual_seed(0)).cuda()
    eager, captured = trainable(splats, "cuda"), trainable(splats, "cuda")
    factor = torch.ones((), device="cuda")
    replay = capture(lambda: train(captured, view, target, factor))
    for step in range(6):
        if step >= 3:  # those before, the capture made
            factor.fill_(1 / step)
            replay()
        train(eager, view, target, 1.0 if step < 3 else 1 / step)
    assert captured.flat().equal(eager.flat())


def test_adam_steps_as_on_a_cpu(make_cloud):
    splats = make_cloud(n=1000)
    on_gpu, on_cpu = trainable(splats, "cuda"), trainable(splats, "cpu")
    for step in range(5):
        for parameters in (on_gpu, on_cpu):
            random = torch.Generator().manual_seed(step)
            splats = parameters.splats()
            leaves = [getattr(splats, f.name) for f in fields(Splats)]
            losses = [(leaf.cpu() * torch.randn(leaf.shape, generator=random)).sum() for leaf in leaves]
            torch.stack(losses).sum().backward()
            parameters.step(0.5)
    assert torch.allclose(on_gpu.flat().cpu(), on_cpu.flat(), atol=1e-5)
