"""Scenes of moving rigid bodies, in one call."""

from dataclasses import replace

import pytest
import torch

from dwgs.scene import InputError
from dwgs.scene.pose import pose, rotation_from_quat
from dwgs.splat import Objects, Splats, View, composite, project, reference, render

IMAGE_TOLERANCE = 5e-6
GRADIENT_TOLERANCE = 2e-6


@pytest.fixture
def objects():
    """Three poses, a metre or so apart."""
    quats = torch.tensor([[1.0, 0, 0, 0], [0.9, 0.1, -0.3, 0.2], [0.5, -0.6, 0.2, 0.3]]).numpy()
    positions = [[0, 0, 0], [1.0, 0.3, -0.5], [-1.2, -0.4, 0.8]]
    poses = torch.tensor(pose(rotation_from_quat(quats), positions), dtype=torch.float32)
    return Objects((120, 1, 179), poses)


@pytest.mark.parametrize("antialiased", [False, True])
def test_image_and_gradients_equal_the_reference(make_cloud, make_view, leaves, gradients, objects, antialiased):
    splats, view = make_cloud(sh_count=9), make_view()
    tensors = [*leaves(splats, view), objects.world_from_object.requires_grad_()]
    inside = (~reference.borderline(splats, view, None, objects, antialiased)).float()
    assert inside.mean() > 0.98
    ours = render(splats, view, objects=objects, antialiased=antialiased)
    theirs = reference.render(splats, view, None, objects, antialiased)
    assert ((ours.rgb - theirs.rgb).abs() * inside[..., None]).max() < IMAGE_TOLERANCE
    for a, b in zip(gradients(ours, tensors, inside), gradients(theirs, tensors, inside), strict=True):
        assert (a - b).norm() < GRADIENT_TOLERANCE * b.norm()


def test_objects_are_clouds_seen_from_their_own_frames(make_cloud, make_view, objects):
    splats, view = make_cloud(), make_view()
    parts, start = [], 0
    for count, world_from_object in zip(objects.counts, objects.world_from_object, strict=True):
        part = Splats(*(getattr(splats, name)[start : start + count] for name in Splats.__dataclass_fields__))
        parts.append(project(part, replace(view, viewmat=view.viewmat @ world_from_object)))
        start += count
    assert torch.allclose(render(splats, view, objects=objects).rgb, composite(parts, view).rgb, atol=1e-5)


def test_every_gaussian_needs_an_object(make_cloud, make_view, objects):
    with pytest.raises(InputError, match="belongs to one object: 200 Gaussians"):
        render(make_cloud(n=200), make_view(), objects=objects)
    with pytest.raises(InputError, match="a count and a pose"):
        Objects((3, 4), torch.eye(4)[None])


def test_antialiasing_dims_what_is_thinner_than_a_pixel(make_view):
    dot = Splats(
        torch.zeros(1, 3), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.03), torch.ones(1), torch.ones(1, 1, 3)
    )
    near, far = make_view(width=200, height=150), make_view(width=50, height=38)
    light = [render(dot, view, antialiased=True).alpha.sum() for view in (near, far)]
    # four times the pixels across: sixteen times the light
    assert light[0] / light[1] == pytest.approx(16, rel=0.2)
    assert render(dot, far).alpha.sum() > 3 * light[1]


def test_a_rendering_goes_over_a_background_that_may_be_learnt(make_cloud, make_view):
    rendering = render(make_cloud(), make_view())
    background = torch.tensor([0.2, 0.5, 0.9], requires_grad=True)
    rendering.over(background).sum().backward()
    assert torch.allclose(background.grad, (1 - rendering.alpha).sum().expand(3))


def test_a_view_is_its_two_halves(make_cloud):
    splats = make_cloud()
    viewmat = torch.eye(4)
    viewmat[2, 3] = 6
    whole = View(viewmat, (90.0, 90.0, 50.0, 38.0), 100, 75)
    left, right = replace(whole, width=48), replace(whole, width=52, intrinsics=(90.0, 90.0, 2.0, 38.0))
    halves = torch.cat([render(splats, left).rgb, render(splats, right).rgb], 1)
    assert torch.allclose(halves, render(splats, whole).rgb, atol=1e-6)
