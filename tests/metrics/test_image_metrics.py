"""PSNR and SSIM."""

import math

import numpy as np
import pytest
import torch
from kornia.metrics import ssim as kornia_ssim

from dwgs.metrics import psnr, ssim


@pytest.fixture
def image():
    return np.random.default_rng(0).random((40, 50, 3)).astype(np.float32)


def test_equal_images_are_infinitely_close(image):
    assert psnr(image, image) == math.inf
    assert ssim(image, image) == pytest.approx(1, abs=1e-5)


def test_ssim_is_that_of_the_field(image):
    noisy = np.clip(image + 0.1, 0, 1)
    usual = kornia_ssim(*(torch.from_numpy(x).permute(2, 0, 1)[None] for x in (noisy, image)), 11)
    assert ssim(noisy, image) == pytest.approx(usual.mean().item(), abs=1e-6)


def test_psnr_of_a_known_error():
    assert psnr(np.full((4, 4, 3), 0.6), np.full((4, 4, 3), 0.5)) == pytest.approx(20)


def test_only_the_mask_counts(image):
    spoilt, mask = image.copy(), np.ones(image.shape[:2], bool)
    spoilt[:5], mask[:5] = 0, False
    assert psnr(spoilt, image, mask) == math.inf
    assert math.isnan(psnr(image, image, np.zeros_like(mask)))


def test_colours_beyond_white_are_clipped_before_comparing():
    assert psnr(np.full((4, 4, 3), 1.5), np.ones((4, 4, 3))) == math.inf
