"""The projection alone, against float64."""

import pytest
import torch

from dwgs.splat import Splats, View, project, reference


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("sh_count", [1, 4, 9, 16])
def test_records_and_their_adjoint_equal_the_reference(make_cloud, make_view, leaves, sh_count, antialiased):
    splats, view = make_cloud(n=400, sh_count=sh_count), make_view()
    tensors = leaves(splats, view)
    projected = project(splats, view, antialiased=antialiased)
    theirs, index = reference.project(splats, view, antialiased=antialiased)
    drawn = projected.visible[index]
    assert drawn.sum() > 300
    ours, theirs = projected.records[index][drawn, :10], theirs[drawn]
    assert ((ours - theirs).abs() <= 1e-5 * (1 + theirs.abs())).all()
    v = torch.randn(ours.shape, generator=torch.Generator().manual_seed(2))
    v[:, 2:5] *= theirs.detach()[:, 2:5].float().abs()  # conics span orders of magnitude
    for a, b in zip(*(torch.autograd.grad((r * v).sum(), tensors) for r in (ours, theirs)), strict=True):
        assert (a - b).norm() < 2e-6 * b.norm()


def test_the_projection_of_the_reference_has_its_own_slopes(make_cloud, make_view):
    cloud, view = make_cloud(n=6), make_view()
    inputs = [getattr(cloud, name).double().requires_grad_() for name in Splats.__dataclass_fields__]
    inputs.append(view.viewmat.double().requires_grad_())

    def records(*tensors):
        one = View(tensors[5], view.intrinsics, view.width, view.height)
        return reference.project(Splats(*tensors[:5]), one, antialiased=True)[0]

    assert torch.autograd.gradcheck(records, inputs)


def test_the_ellipse_of_a_record_is_where_alpha_is_cut(make_cloud, make_view):
    records = project(make_cloud(), make_view()).records
    records = records[records[:, 10] > 0].double()
    xx, xy, yy, opacity = records[:, 2:6].unbind(1)
    extent_x, extent_y, log_opacity, tilt, summit, waist = records[:, 10:].unbind(1)
    assert torch.allclose(log_opacity, opacity.log(), atol=1e-6)

    def alpha(dx, dy):
        return opacity * (-0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy).exp()

    edge = torch.full_like(opacity, 1 / 255)
    assert torch.allclose(alpha(summit, extent_y), edge, rtol=1e-3)
    assert torch.allclose(alpha(extent_x, tilt * extent_x), edge, rtol=1e-3)
    for share in (-0.7, 0.2, 0.9):
        dx = share * extent_x
        for side in (-1, 1):
            assert torch.allclose(alpha(dx, tilt * dx + side * waist * (1 - share**2) ** 0.5), edge, rtol=1e-3)
