from dataclasses import replace

import numpy as np
import pytest
from test_distill import run
from toy_street import Toy, box_surface, cloud, make_toy, paint

from dwgs.distill import DistillConfig
from dwgs.distill.appearance import Appearance
from dwgs.distill.lacquer import mirrored
from dwgs.distill.light import find_light
from dwgs.distill.symmetry import complete
from dwgs.metrics import psnr
from dwgs.scene import Camera
from dwgs.scene.pose import pose
from dwgs.splat import Splats, View, render

CONFIG = DistillConfig(steps=150, gaussians=1500, shadow_margin=0, threads=1)
UNSEEN = np.radians([60, 90, 120])


def toy_painted(left) -> Toy:
    """The toy whose right side, which alone the camera sees, is as ever, and whose left is ``left(points)``."""
    toy = make_toy()
    points, _ = box_surface(np.random.default_rng(5), 6000)
    mirrored = points * [1, -1, 1]
    colors = np.where(points[:, 1:2] < 0, paint(points), left(points, mirrored))
    return replace(toy, truth=cloud(points, colors, [0.05, 0.05, 0.05]))


def orbit(truth, body, azimuths) -> float:
    """Mean PSNR [dB] of the body from these sides, over the true vehicle's pixels."""
    values = []
    for azimuth in azimuths:
        toward = np.array([np.cos(azimuth), np.sin(azimuth), 0.08])
        toward /= np.linalg.norm(toward)
        right = np.array([-np.sin(azimuth), np.cos(azimuth), 0])
        around = pose(np.stack([right, -np.cross(toward, right), -toward], 1), 8 * toward)
        camera = Camera(np.array([[120.0, 0, 48], [0, 120, 32], [0, 0, 1]]), 96, 64, around, 0.0)
        true, found = (render(Splats.from_gaussians(g), View.from_camera(camera)) for g in (truth, body))
        values.append(psnr(found.rgb.numpy(), true.rgb.numpy(), true.alpha.numpy() > 0.5))
    return float(np.mean(values))


def distilled(toy, symmetry):
    return run(toy.scene(), toy.background, toy.insertion, replace(CONFIG, symmetry=symmetry))[1:]


@pytest.fixture(scope="module")
def symmetric():
    toy = toy_painted(lambda points, mirrored: paint(mirrored))
    return toy, distilled(toy, True), distilled(toy, False)


def test_a_side_that_no_camera_saw_looks_like_the_other(symmetric):
    toy, (asset, _), (without, _) = symmetric
    assert orbit(toy.truth, asset.body, UNSEEN) > orbit(toy.truth, without.body, UNSEEN) + 3.5


def test_frames_are_explained_as_well_as_without(symmetric):
    _, (_, report), (_, plain) = symmetric
    assert report["psnr_roi_heldout"] > plain["psnr_roi_heldout"] - 0.05


def test_a_livery_on_the_unseen_side_costs_the_seen_side_nothing():
    toy = toy_painted(lambda points, mirrored: 1 - paint(points))
    (_, report), (_, plain) = (distilled(toy, symmetry) for symmetry in (True, False))
    assert report["psnr_roi_heldout"] > plain["psnr_roi_heldout"] - 0.05


def test_a_side_whose_points_are_painted_otherwise_stays_so():
    means, normals = box_surface(np.random.default_rng(0), 2000)
    paints = np.where(means[:, 1:2] > 0, [0.1, 0.2, 0.7], [0.7, 0.2, 0.1])
    seen = normals[:, 1] < 0
    once, colors = seen.astype(float), np.where(seen[:, None], 0.9 * paints, 0)
    appearance = Appearance(normals, colors, once, mirrored(normals, normals))
    light = find_light(paints, appearance)
    completed = complete(means, paints, appearance, light).colors(light, normals)
    red, _, blue = completed[normals[:, 1] > 0].mean(0)
    assert blue > red + 0.25


def shown_in(colors, seen):
    """A row of discs that face right, as far as they are ``seen`` in these colours."""
    means = np.column_stack([np.linspace(0, 4, len(seen)), np.full((len(seen), 2), -1.0)])
    normals, once = np.tile([0, -1.0, 0], (len(seen), 1)), seen.astype(float)
    return means, Appearance(normals, np.where(seen[:, None], colors, 0), once, mirrored(normals, normals))


def test_what_frames_show_is_believed_though_light_does_not_explain_it():
    seen = np.ones(200, bool)
    colors = np.random.default_rng(0).uniform(0.2, 0.8, (200, 3))
    means, appearance = shown_in(colors, seen)
    light = find_light(np.full((200, 3), 0.5), appearance)
    completed = complete(means, np.full((200, 3), 0.5), appearance, light)
    np.testing.assert_allclose(completed.colors(light, appearance.normals), colors, atol=1e-6)


def test_one_stain_at_the_edge_of_what_is_shown_does_not_run_over_all_the_rest():
    seen = np.arange(200) < 100
    colors = np.where(np.arange(200)[:, None] < 90, [0.5, 0.5, 0.5], [0.9, 0.1, 0.1])
    means, appearance = shown_in(colors, seen)
    light = find_light(np.full((200, 3), 0.5), appearance)
    completed = complete(means, np.full((200, 3), 0.5), appearance, light).colors(light, appearance.normals)
    next_to_it, far = completed[100], completed[-1]
    assert next_to_it[0] > 0.8
    np.testing.assert_allclose(far, 0.5, atol=0.06)


def test_the_asset_says_what_symmetry_completed(symmetric):
    _, (asset, report), (_, plain) = symmetric
    share = report["share_completed_by_symmetry"]
    unseen = (asset.observations == 0).mean()
    assert 0.1 < share <= unseen
    assert plain["share_completed_by_symmetry"] == 0
    assert asset.quality["share_completed_by_symmetry"] == share
