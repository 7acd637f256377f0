import pytest
import torch
from kornia.filters import gaussian_blur2d
from kornia.metrics import ssim as ssim_map

from dwgs.optimize import RetainedMse, dssim, weighted_l1, weighted_mse


def images(height=64, width=80):
    noise = torch.rand(2, 3, height, width, generator=torch.Generator().manual_seed(0))
    smooth = gaussian_blur2d(noise, (9, 9), (2.0, 2.0)).permute(0, 2, 3, 1)
    return (smooth - smooth.mean()) * 4 + 0.5


def test_weights_select_the_pixels_that_count():
    rgb, target = images()
    weight = torch.zeros(64, 80)
    weight[:32] = 1
    torch.testing.assert_close(weighted_l1(rgb, target, weight), (rgb - target)[:32].abs().mean())
    torch.testing.assert_close(weighted_mse(rgb, target, weight), (rgb - target)[:32].square().mean())


def test_dssim_is_zero_for_equal_images_and_near_the_gaussian_one_for_others():
    rgb, target = images()
    weight = torch.ones(64, 80)
    assert dssim(rgb, rgb, weight) < 1e-6
    for share in (0.1, 0.3, 0.6):
        mixed = (1 - share) * target + share * rgb
        usual = (1 - ssim_map(mixed.permute(2, 0, 1)[None], target.permute(2, 0, 1)[None], 11).mean()) / 2
        torch.testing.assert_close(dssim(mixed, target, weight), usual, rtol=0.25, atol=0.01)


def test_dssim_has_the_gradient_of_finite_differences():
    rgb, target = (image.double() for image in images(18, 21))
    weight = torch.rand(18, 21, generator=torch.Generator().manual_seed(1)).double() + 0.1
    assert torch.autograd.gradcheck(lambda x: dssim(x, target, weight), rgb.requires_grad_())


def test_dssim_never_sees_pixels_without_weight_and_takes_images_of_any_size():
    rgb, target = images(5, 7)
    weight = torch.ones(5, 7)
    weight[2, 3] = 0
    expected = dssim(rgb, target, weight)
    rgb[2, 3] = 1e6
    torch.testing.assert_close(dssim(rgb, target, weight), expected)


@pytest.mark.parametrize("loss", [weighted_l1, weighted_mse, dssim])
@pytest.mark.parametrize("size", [(64, 80), (33, 47), (5, 7), (1, 1)])
def test_the_quick_way_is_the_exact_one(loss, size):
    rgb, target = (image[: size[0], : size[1]] for image in images())
    weight = torch.rand(size, generator=torch.Generator().manual_seed(2))
    weight = torch.where(weight > 0.3, weight, 0)
    exact = loss(*(t.double() for t in (rgb.requires_grad_(), target, weight)))
    quick = loss(rgb, target, weight)
    torch.testing.assert_close(quick, exact.float(), rtol=1e-5, atol=1e-7)
    v_exact, v_quick = (torch.autograd.grad(3 * value, rgb)[0] for value in (exact, quick))
    torch.testing.assert_close(v_quick, v_exact, rtol=1e-4, atol=1e-4 * float(v_exact.abs().max()))


def test_a_retained_error_follows_the_image():
    rgb, target = (image.movedim(-1, 0).contiguous().movedim(0, -1) for image in images(33, 47))
    weight = torch.rand(33, 47, generator=torch.Generator().manual_seed(2))
    gradient = torch.empty(3, 33, 47).movedim(0, -1)
    error = RetainedMse(rgb, target, weight, gradient)
    for _ in range(2):
        rgb.mul_(0.7)
        leaf = rgb.clone().requires_grad_()
        expected = weighted_mse(leaf, target, weight)
        assert error() == pytest.approx(expected.item(), rel=1e-5)
        torch.testing.assert_close(gradient, torch.autograd.grad(expected, leaf)[0])
