"""Measures of one edited drive."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dwgs.evaluation import Subject, measure
from dwgs.scene import Camera, Frame, Insertion, Scene, Trajectory, VehiclePoints
from dwgs.scene.pose import pose

FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
WIDTH, HEIGHT, FRAMES = 60, 40, 4
SIZE = np.array([4.0, 2.0, 1.5])


def scene(images, mask=None):
    K = np.array([[60.0, 0, WIDTH / 2], [0, 60, HEIGHT / 2], [0, 0, 1]])
    frames = tuple(
        Frame(
            i,
            "front",
            Camera(K, WIDTH, HEIGHT, pose(FORWARD, [0, 0, 0]), 0.1 * i),
            lambda image=image: image.copy(),
            None if mask is None else lambda: mask.copy(),
        )
        for i, image in enumerate(images)
    )
    return Scene("toy", {"front": frames}, Trajectory(np.zeros(1), np.eye(4)[None]))


@pytest.fixture
def images():
    return np.random.default_rng(0).integers(0, 200, (FRAMES, HEIGHT, WIDTH, 3), np.uint8)


@pytest.fixture
def mask():
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10:30, 20:45] = True
    return mask


@pytest.fixture
def subject(images, mask):
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5, 0.5, (3000, 3)) * SIZE
    points[:, 0] = -SIZE[0] / 2
    colors = rng.integers(0, 256, (3000, 3)).astype(np.uint8)
    times = 0.1 * np.arange(FRAMES)
    poses = np.tile(pose(np.eye(3), [10, 0, 0]), (FRAMES, 1, 1))
    insertion = Insertion(VehiclePoints(points.astype(np.float32), colors), SIZE, Trajectory(times, poses))
    truth = images.copy()
    truth[:, mask] += 20
    return Subject(scene(images), insertion, (mask.copy,) * FRAMES, scene(truth, mask))


def test_the_truth_is_exact_and_keeps_the_background(subject):
    values = measure(subject, subject.truth)
    assert values["oracle_psnr"] == math.inf
    assert values["oracle_ssim"] == pytest.approx(1)
    assert values["kept"] == 100


def test_psnr_counts_only_where_systems_may_paint(subject, images):
    spoilt = images.copy()
    spoilt[:, :5] = 0  # outside the mask
    values = measure(subject, scene(spoilt))
    assert values["oracle_psnr"] == pytest.approx(20 * math.log10(255 / 20))


def test_the_share_of_kept_pixels_is_exact(subject, images, mask):
    changed = images.copy()
    changed[0, :4, :5] ^= 1  # one bit of twenty pixels outside the mask of one frame
    values = measure(subject, scene(changed))
    assert values["kept"] == pytest.approx(100 * (1 - 20 / (FRAMES * (~mask).sum())))


def test_what_truly_shows_beyond_the_mask_counts_as_well(subject, images, mask):
    wider = mask | np.roll(mask, 3, axis=1)
    other = images.copy()
    other[:, mask] += 20
    narrow = measure(subject, scene(other))
    truth = images.copy()
    truth[:, wider] += 20
    wide = measure(replace(subject, truth=scene(truth, wider)), scene(other))
    assert narrow["oracle_psnr"] == math.inf
    assert math.isfinite(wide["oracle_psnr"])


def test_without_a_truth_nothing_is_held_against_it(subject):
    values = measure(replace(subject, truth=None), subject.recorded)
    assert set(values) == {"kept", "point_error", "flicker"}


def test_noise_flickers_and_a_still_video_does_not(subject, images):
    still = np.repeat(images[:1], FRAMES, 0)
    assert measure(subject, scene(still))["flicker"] == pytest.approx(0, abs=1e-4)
    assert measure(subject, scene(images))["flicker"] > 20


def test_progress_counts_every_frame(subject):
    told = []
    measure(subject, subject.truth, lambda done, total: told.append((done, total)))
    assert told == [(i + 1, FRAMES) for i in range(FRAMES)]
