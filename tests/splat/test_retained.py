"""Pictures that are drawn again and again are what `render` and autograd make of the same splats."""

from dataclasses import fields, replace

import pytest
import torch

from dwgs.splat import Layers, Projected, RetainedCloud, Splats, View, composite, project, render


def layers_of(view: View) -> Layers:
    random = torch.Generator().manual_seed(1)
    shape = view.height, view.width
    front, back = (torch.rand(*shape, 3, generator=random) for _ in range(2))
    depth, alpha = (torch.rand(*shape, generator=random) for _ in range(2))
    return Layers.of((0.3 * front, depth, torch.full(shape, 0.7)), (back, depth, alpha))


@pytest.fixture
def scene(make_cloud, make_view):
    splats = make_cloud(n=700)
    splats = Splats(*(getattr(splats, f.name).requires_grad_() for f in fields(Splats)))
    views = [make_view(seed=1), make_view(width=160, height=120, seed=2)]
    return splats, views


def gradients_by(splats, view, layers, among, weights):
    rendering = render(splats, view, layers, among=among)
    outputs = rendering.rgb, rendering.depth, rendering.alpha
    leaves = [*(getattr(splats, f.name) for f in fields(Splats)), view.viewmat]
    return outputs, torch.autograd.grad(outputs, leaves, weights)


@pytest.mark.parametrize("threads", [1, 2])
def test_images_and_gradients_are_those_of_render_while_the_splats_change(scene, threads):
    splats, views = scene
    cloud = RetainedCloud(splats, threads, moves=True)
    stages = [None, layers_of(views[1])]
    pictures = [cloud.picture(view, layers) for view, layers in zip(views, stages, strict=True)]
    random = torch.Generator().manual_seed(3)
    for _ in range(3):  # memory grows, is packed anew, and stays
        for picture, view, layers in zip(pictures, views, stages, strict=True):
            with torch.no_grad():
                splats.means.add_(torch.randn(splats.means.shape, generator=random), alpha=0.05)
                picture.viewmat[:3, 3] += 0.01
            moved = View(picture.viewmat.clone().requires_grad_(), view.intrinsics, view.width, view.height)
            drawing = picture.draw()
            weights = [
                torch.randn(image.shape, generator=random) for image in (drawing.rgb, drawing.depth, drawing.alpha)
            ]
            images, expected = gradients_by(splats, moved, layers, None, weights)
            for ours, theirs in zip((drawing.rgb, drawing.depth, drawing.alpha), images, strict=True):
                assert ours.equal(theirs)
            for ours, weight in zip((drawing.v_rgb, drawing.v_depth, drawing.v_alpha), weights, strict=True):
                ours.copy_(weight)
            picture.adjoint()
            for leaf, gradient in zip(cloud.leaves, expected, strict=False):
                assert leaf.grad.equal(gradient)
            torch.testing.assert_close(picture.v_viewmat, expected[-1])


@pytest.mark.parametrize("opacity", [0.05, 1.0])
@pytest.mark.parametrize("layered", [False, True])
def test_frozen_gaussians_among_the_splats_are_met_as_by_render(scene, make_cloud, opacity, layered):
    """To the rounding where they are faint; else to what the rule leaves out that stops where light runs out."""
    splats, (view, _) = scene
    others = make_cloud(n=600, seed=5)
    others = project(replace(others, opacities=others.opacities * opacity), view)
    layers = layers_of(view) if layered else None
    cloud = RetainedCloud(splats, 2, moves=True)
    picture, random = cloud.picture(view, layers, others), torch.Generator().manual_seed(3)
    for _ in range(3):
        with torch.no_grad():
            splats.means.add_(torch.randn(splats.means.shape, generator=random), alpha=0.05)
        moved = View(view.viewmat.clone().requires_grad_(), view.intrinsics, view.width, view.height)
        drawing = picture.draw()
        ours = drawing.rgb, drawing.depth, drawing.alpha
        weights = [torch.randn(image.shape, generator=random) for image in ours]
        images, expected = gradients_by(splats, moved, layers, others, weights)
        for image, theirs, scale in zip(ours, images, (1, 10, 1), strict=True):  # depths reach 10 m
            assert (image - theirs).abs().max() < (1e-5 if opacity < 1 else 2e-4) * scale
        for given, weight in zip((drawing.v_rgb, drawing.v_depth, drawing.v_alpha), weights, strict=True):
            given.copy_(weight)
        picture.adjoint()
        for gradient, theirs in zip([leaf.grad for leaf in cloud.leaves] + [picture.v_viewmat], expected, strict=True):
            assert (gradient - theirs).norm() < (1e-5 if opacity < 1 else 1e-3) * theirs.norm()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_picture_forgets_what_it_showed_before(scene, make_cloud, threads):
    splats, (_, view) = scene
    others, layers = project(make_cloud(n=600, seed=5), view), layers_of(view)
    cloud = RetainedCloud(splats, threads)
    picture = cloud.picture(view, layers, others)
    for shift in (3.0, -2.0, -1.0):
        with torch.no_grad():
            splats.means[:, 2] += shift
        picture.draw()
    drawing = picture.draw()
    remembered = [image.clone() for image in (drawing.rgb, drawing.depth, drawing.alpha)]
    fresh = RetainedCloud(splats, 1).picture(view, layers, others).draw()
    for a, b in zip(remembered, (fresh.rgb, fresh.depth, fresh.alpha), strict=True):
        assert a.equal(b)


def test_frozen_gaussians_outside_the_image_change_nothing(scene, make_cloud):
    splats, (view, _) = scene
    records = project(make_cloud(n=50, seed=5), view).records + torch.tensor([1e4, *[0.0] * 15])
    images = []
    for among in (None, Projected(records), Projected(records[:0])):
        drawing = RetainedCloud(splats, 1).picture(view, None, among).draw()
        images.append(torch.stack([*drawing.rgb.unbind(-1), drawing.depth, drawing.alpha]))
    assert images[0].equal(images[1])
    assert images[0].equal(images[2])


def test_what_renders_among_splats_is_what_composites_with_them(scene, make_cloud):
    splats, (view, _) = scene
    others = project(make_cloud(n=80, seed=9), view)
    by_render = render(splats, view, layers_of(view), among=others)
    by_parts = composite([project(splats, view), others], view, layers_of(view))
    torch.testing.assert_close(by_render.rgb, by_parts.rgb)
    leaves = [getattr(splats, f.name) for f in fields(Splats)]
    ours, theirs = (torch.autograd.grad(rendering.rgb.sum(), leaves) for rendering in (by_render, by_parts))
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b)
