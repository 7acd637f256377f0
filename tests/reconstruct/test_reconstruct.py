from dataclasses import replace

import numpy as np
import pytest
from toy_drive import CAR_SIZE, HEIGHT, WIDTH, K, make_drive, paint, repaint

from dwgs.optimize import Checkpoint, Grown, Step
from dwgs.reconstruct import ReconstructConfig, moving_mask, reconstruct
from dwgs.reconstruct.evaluate import show_background
from dwgs.reconstruct.views import split_frames
from dwgs.scene import Camera, InputError
from dwgs.scene.pose import pose
from dwgs.splat import Splats, View, render

CONFIG = ReconstructConfig(steps=30, gaussians=4000, grown=300, threads=1)


def fit(scene, config=CONFIG, checkpoint=None):
    """(background, report, events)."""
    run, events = reconstruct(scene, config, checkpoint), []
    while True:
        try:
            events.append(next(run))
        except StopIteration as stop:
            return *stop.value, events


def digest(background):
    g = background.gaussians
    poses = b"".join(background.poses[key].tobytes() for key in sorted(background.poses))
    return b"".join(x.tobytes() for x in (g.means, g.quats, g.scales, g.opacities, g.sh, background.sky)) + poses


@pytest.fixture(scope="module")
def fitted(drive):
    return fit(drive)


def test_steps_bring_the_street_nearer_to_frames_that_were_held_out(drive, fitted):
    _, start, _ = fit(drive, replace(CONFIG, steps=1))
    _, report, events = fitted
    assert report["psnr_heldout"] > start["psnr_heldout"] + 1
    assert report["psnr_heldout"] > 27
    assert [e.step for e in events if isinstance(e, Step)] == list(range(1, 31))
    counts = [e.count for e in events if isinstance(e, Grown)]
    assert len(counts) == 4
    assert counts == sorted(counts)
    assert report["gaussians"] <= counts[-1]


def test_the_same_drive_gives_the_same_bytes_on_any_number_of_threads(drive, fitted):
    assert digest(fit(drive, replace(CONFIG, threads=2))[0]) == digest(fitted[0])


def test_an_interrupted_fit_goes_on_to_the_same_bytes(drive, fitted, tmp_path, monkeypatch):
    monkeypatch.setattr("dwgs.optimize.checkpoint.EVERY", 0)
    for stop in (2, 10, 29):  # before and after it grows
        interrupted = reconstruct(drive, CONFIG, Checkpoint(tmp_path / "half.pt"))
        while getattr(next(interrupted), "step", 0) != stop:
            pass
        interrupted.close()
    background, report, events = fit(drive, checkpoint=Checkpoint(tmp_path / "half.pt"))
    assert [e.step for e in events if isinstance(e, Step)] == [29, 30]
    assert digest(background) == digest(fitted[0])
    assert report["psnr_heldout"] == fitted[1]["psnr_heldout"]


def test_held_out_frames_never_touch_the_street(drive, fitted):
    _, judging = split_frames(drive)
    held = {frame.index for frame in judging}
    assert held == {4}
    changed = repaint(drive, lambda f, pixels: 255 - pixels if f.index in held else pixels)
    background, report, _ = fit(changed)
    assert digest(background) == digest(fitted[0])
    assert report["psnr_heldout"] < fitted[1]["psnr_heldout"] - 5


def test_pixels_of_traffic_never_touch_the_street(drive, fitted):
    def scramble(frame, pixels):
        mask = moving_mask(drive, frame)
        pixels[mask] = np.random.default_rng(frame.index).integers(0, 256, (mask.sum(), 3))
        return pixels

    assert digest(fit(repaint(drive, scramble))[0]) == digest(fitted[0])


def test_the_road_that_was_always_under_traffic_is_filled_and_opaque(drive, fitted):
    background = fitted[0]
    # Where the car drove for the whole drive, seen from above and behind it.
    rotation = np.array([[0, -np.sin(0.6), np.cos(0.6)], [-1, 0, 0], [0, -np.cos(0.6), -np.sin(0.6)]])
    camera = Camera(K, WIDTH, HEIGHT, pose(rotation, [4, 0.5, 5]), 0.0)
    view = View.from_camera(camera)
    splats = Splats.from_gaussians(background.gaussians)
    rendering = render(splats, view, threads=1)
    under = drive.tracks[0].trajectory.at(0.4)[:3, 3] - [0, 0, CAR_SIZE[2] / 2]
    pixel = np.floor(camera.project(under[None])[0][0]).astype(int)
    window = np.s_[pixel[1] - 5 : pixel[1] + 5, pixel[0] - 5 : pixel[0] + 5]
    assert rendering.alpha.numpy()[window].mean() > 0.95
    assert rendering.alpha.numpy()[window].min() > 0.8
    error = np.abs(show_background(background, splats, camera, "front") - paint(camera) / 255)[window]
    assert error.mean() < 0.15
    np.testing.assert_allclose(
        rendering.expected_depth.numpy()[window].mean(), camera.project(under[None])[1][0], rtol=0.1
    )


def test_a_street_without_tracks_is_reconstructed_too():
    _, report, _ = fit(make_drive(frames=5, traffic=False))
    assert report["psnr_heldout"] > 24


def test_a_drive_too_short_to_hold_a_frame_out_says_so_with_none():
    _, report, _ = fit(make_drive(frames=3), replace(CONFIG, steps=2))
    assert report["psnr_heldout"] is None
    assert report["psnr_train"] > 15


def test_without_lidar_the_message_says_what_is_missing(drive):
    with pytest.raises(InputError, match="'toy' has no LiDAR sweep"):
        fit(replace(drive, sweeps=()))


def test_lidar_elsewhere_is_told_from_lidar_in_view(drive):
    moved = tuple(replace(s, points=s.points - np.float32([60, 0, 0])) for s in drive.sweeps)
    with pytest.raises(InputError, match="no LiDAR point of 'toy' lies in front"):
        fit(replace(drive, sweeps=moved))
