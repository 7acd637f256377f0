"""Pictures that are drawn again and again are what `render` and autograd make of the same splats."""

from dataclasses import fields

import pytest
import torch

from dwgs.splat import Layers, RetainedCloud, Splats, View, composite, project, render


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
def test_images_and_gradients_are_those_of_render_while_the_splats_change(scene, make_cloud, threads):
    splats, views = scene
    cloud = RetainedCloud(splats, threads, moves=True)
    extras = [(None, None), (layers_of(views[1]), project(make_cloud(n=50, seed=5), views[1]))]
    pictures = [cloud.picture(view, *extra) for view, extra in zip(views, extras, strict=True)]
    random = torch.Generator().manual_seed(3)
    for _ in range(3):  # memory grows, is packed anew, and stays
        for picture, view, extra in zip(pictures, views, extras, strict=True):
            with torch.no_grad():
                splats.means.add_(torch.randn(splats.means.shape, generator=random), alpha=0.05)
                picture.viewmat[:3, 3] += 0.01
            moved = View(picture.viewmat.clone().requires_grad_(), view.intrinsics, view.width, view.height)
            drawing = picture.draw()
            weights = [
                torch.randn(image.shape, generator=random) for image in (drawing.rgb, drawing.depth, drawing.alpha)
            ]
            images, expected = gradients_by(splats, moved, *extra, weights)
            for ours, theirs in zip((drawing.rgb, drawing.depth, drawing.alpha), images, strict=True):
                assert ours.equal(theirs)
            for ours, weight in zip((drawing.v_rgb, drawing.v_depth, drawing.v_alpha), weights, strict=True):
                ours.copy_(weight)
            picture.adjoint()
            for leaf, gradient in zip(cloud.leaves, expected, strict=False):
                assert leaf.grad.equal(gradient)
            torch.testing.assert_close(picture.v_viewmat, expected[-1])


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
