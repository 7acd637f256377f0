from dataclasses import replace

import numpy as np
import pytest

from dwgs.distill import DistillConfig, distill
from dwgs.optimize import Checkpoint, Evaluated, Step
from dwgs.scene import Gaussians, InputError, LidarSweep, Scene, Trajectory
from dwgs.scene.pose import pose

QUICK = DistillConfig(steps=12, gaussians=400, shadow_margin=0.3, threads=1)


def run(scene, background, insertion, config=QUICK, checkpoint=None):
    events, loop = [], distill(scene, background, insertion, config, checkpoint)
    while True:
        try:
            events.append(next(loop))
        except StopIteration as stop:
            return events, stop.value.asset, stop.value.report


def same(a: Gaussians, b: Gaussians) -> bool:
    fields = ("means", "quats", "scales", "opacities", "sh")
    return all(np.array_equal(getattr(a, f), getattr(b, f)) for f in fields)


@pytest.fixture(scope="module")
def quick(toy):
    return run(toy.scene(), toy.background, toy.insertion)


def test_a_generated_vehicle_is_recovered(toy):
    config = DistillConfig(steps=100, gaussians=1500, shadow_margin=0.3, threads=1)
    events, asset, report = run(toy.scene(), toy.background, toy.insertion, config)
    assert report["psnr_roi_heldout"] > 36
    assert report["ssim_roi_heldout"] > 0.98
    steps = [e for e in events if isinstance(e, Step)]
    assert [e.step for e in steps] == list(range(1, 101))
    assert isinstance(events[-1], Evaluated)
    assert report["gaussians"] == len(asset.body) + len(asset.shadow)


def test_the_same_input_gives_the_same_bytes(toy, quick):
    _, asset, _ = run(toy.scene(), toy.background, toy.insertion)
    assert same(asset.gaussians, quick[1].gaussians)


def test_the_number_of_threads_changes_no_byte(toy, quick):
    _, asset, _ = run(toy.scene(), toy.background, toy.insertion, replace(QUICK, threads=2))
    assert same(asset.gaussians, quick[1].gaussians)


@pytest.mark.parametrize("is_generated", [True, False])
def test_an_interrupted_fit_goes_on_to_the_same_bytes(toy, tmp_path, monkeypatch, is_generated):
    monkeypatch.setattr("dwgs.optimize.checkpoint.EVERY", 0)
    config = replace(QUICK, steps=40)
    inputs = toy.scene(is_generated=is_generated), toy.background, toy.insertion, config
    _, asset, _ = run(*inputs)
    for stop in (5, 31, 39):
        interrupted = distill(*inputs, Checkpoint(tmp_path / "half.pt"))
        while getattr(next(interrupted), "step", 0) != stop:
            pass
        interrupted.close()
    events, again, _ = run(*inputs, Checkpoint(tmp_path / "half.pt"))
    assert [event.step for event in events if isinstance(event, Step)] == [40]
    assert same(again.gaussians, asset.gaussians)


def test_a_trajectory_that_trembles_is_put_right(toy):
    random = np.random.default_rng(0)
    poses = toy.insertion.trajectory.world_from_vehicle.copy()
    poses[:, :3, 3] += random.normal(0, 0.05, (len(poses), 3))
    trembling = replace(toy.insertion, trajectory=Trajectory(toy.insertion.trajectory.times, poses))
    config = DistillConfig(steps=200, gaussians=1500, shadow_margin=0.3, threads=1)
    _, _, report = run(toy.scene(), toy.background, trembling, config)
    assert report["psnr_roi_heldout"] > 33
    assert 0.04 < report["pose_correction_rms_m"] < 0.12


def test_a_smooth_trajectory_is_left_alone(quick):
    assert not any(key.startswith("pose") for key in quick[2])


def test_the_background_is_left_alone(toy):
    arrays = [*vars(toy.background.gaussians).values(), toy.background.sky]
    before = [a.tobytes() for a in arrays]
    _, _, report = run(toy.scene(), toy.background, toy.insertion, replace(QUICK, steps=3))
    assert [a.tobytes() for a in arrays] == before
    assert report["background_unchanged"] is True


def test_held_out_frames_teach_nothing(toy, quick):
    scene = toy.scene()
    frames = list(scene.frames["front"])
    noise = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)
    frames[4] = replace(frames[4], load_pixels=lambda: noise)
    _, asset, report = run(replace(scene, frames={"front": tuple(frames)}), toy.background, toy.insertion)
    assert [f["frame"] for f in report["frames"] if f["heldout"]] == [4]
    assert same(asset.gaussians, quick[1].gaussians)


def test_a_schedule_made_for_seconds_fills_them(toy):
    _, asset, report = run(toy.scene(), toy.background, toy.insertion, replace(QUICK, seconds=3.0))
    assert 1 < report["steps"] != QUICK.steps
    assert report["seconds"]["prepare"] + report["seconds"]["fit"] == pytest.approx(3, abs=1)
    assert len(asset.body) > 0


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), 1e-6])
def test_no_time_to_fit_is_refused(toy, seconds):
    with pytest.raises(InputError, match=r"time|seconds|given"):
        run(toy.scene(), toy.background, toy.insertion, replace(QUICK, seconds=seconds))


def sweeps_through(toy, depth_inside):
    """A return through every pixel of every frame, at ``depth_inside`` [m] within the reactive mask."""
    for frame in toy.scene().frames["front"]:
        camera = frame.camera
        x, y = np.meshgrid(np.arange(96) + 0.5, np.arange(64) + 0.5)
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T @ camera.world_from_camera[:3, :3].T
        depth = np.where(frame.reactive_mask, depth_inside, 12.0)[..., None]
        points = (camera.position + depth * rays).reshape(-1, 3).astype(np.float32)
        yield LidarSweep(points, np.full(len(points), camera.time), camera.position, camera.time, frame.index)


def test_lidar_inside_the_reactive_mask_changes_no_byte(toy, quick):
    assets = [run(toy.scene(sweeps_through(toy, depth)), toy.background, toy.insertion)[1] for depth in (3.0, 25.0)]
    assert same(assets[0].gaussians, assets[1].gaussians)
    assert not same(assets[0].gaussians, quick[1].gaussians)  # outside it does count


def test_centres_stay_where_the_layers_expect_them(toy, quick):
    size = toy.insertion.size
    assert (np.abs(quick[1].body.means) <= size / 2 + 0.1501).all()
    assert (quick[1].shadow.means[:, 2] < -size[2] / 2 + 0.13).all()


def test_a_recorded_car_is_learnt_although_its_box_is_off(toy):
    config = DistillConfig(steps=100, gaussians=1200, shadow_margin=0.3, threads=1)
    trajectory = toy.insertion.trajectory
    shaken = trajectory.world_from_vehicle.copy()
    shaken[:, :3, 3] += np.random.default_rng(1).normal(0, 0.04, (len(shaken), 3)) * [1, 1, 0.3]
    insertion = replace(toy.insertion, trajectory=Trajectory(trajectory.times, shaken))
    _, _, report = run(toy.scene(is_generated=False), toy.background, insertion, config)
    assert report["kind"] == "recorded"
    assert report["psnr_roi_train"] > 28


def test_a_vehicle_seen_once_is_learnt_from_that_frame(toy):
    scene = toy.scene().select(frames=range(5, 6))
    _, asset, report = run(scene, toy.background, toy.insertion)
    assert report["psnr_roi_heldout"] is None
    assert report["psnr_roi_train"] > 20
    assert len(asset.body) > 0


def test_the_only_frames_that_show_it_are_never_all_held_out(toy):
    frames = list(toy.scene().frames["front"])
    hidden = np.zeros((64, 96), bool)
    frames = [f if i == 4 else replace(f, load_reactive_mask=lambda: hidden) for i, f in enumerate(frames)]
    _, _, report = run(Scene("once", {"front": tuple(frames)}, toy.insertion.trajectory), toy.background, toy.insertion)
    assert [f["heldout"] for f in report["frames"]] == [False]


def test_a_vehicle_that_enters_and_leaves_the_image_is_learnt(toy):
    sideways = toy.insertion.trajectory.world_from_vehicle.copy()
    sideways[:, 1, 3] = np.linspace(8, -8, len(sideways))
    moved = replace(
        toy, insertion=replace(toy.insertion, trajectory=Trajectory(toy.insertion.trajectory.times, sideways))
    )
    _, _, report = run(moved.scene(), moved.background, moved.insertion)
    assert 3 < len(report["frames"]) < 12
    assert report["psnr_roi_train"] > 20


def test_a_vehicle_behind_every_camera_is_refused(toy):
    behind = toy.insertion.trajectory.moved(pose(np.eye(3), [-40, 0, 0]))
    with pytest.raises(InputError, match="no frame of 'toy' shows the vehicle"):
        run(toy.scene(), toy.background, replace(toy.insertion, trajectory=behind))


def test_a_trajectory_shorter_than_the_clip_is_refused(toy):
    short = Trajectory(toy.insertion.trajectory.times[:5], toy.insertion.trajectory.world_from_vehicle[:5])
    with pytest.raises(InputError, match=r"trajectory covers 0\.00-0\.40 s"):
        run(toy.scene(), toy.background, replace(toy.insertion, trajectory=short))


def test_a_schedule_without_steps_is_refused(toy):
    with pytest.raises(InputError, match="at least one step"):
        run(toy.scene(), toy.background, toy.insertion, DistillConfig(steps=0))


def test_the_report_says_what_was_seen(quick):
    _, asset, report = quick
    assert report["side_pixels"]["right"] > report["side_pixels"]["left"]
    assert sum(sector["share"] for sector in report["sectors"]) == pytest.approx(1, abs=1e-3)
    assert asset.quality["psnr_roi_heldout"] == report["psnr_roi_heldout"]
    assert asset.provenance["config"]["steps"] == QUICK.steps
    assert isinstance(report["frames"][0]["frame"], int)
    judged = [sector["psnr_roi_heldout"] for sector in report["sectors"] if sector["psnr_roi_heldout"]]
    assert np.mean(judged) == pytest.approx(report["psnr_roi_heldout"], abs=3)


def test_the_asset_knows_which_gaussians_were_seen(toy, quick):
    _, asset, report = quick
    assert asset.observations.max() == report["frames_taught"]
    side = asset.body.means[:, 1]  # the camera sees the right of it
    assert asset.observations[side < -0.8].mean() > 4 * asset.observations[side > 0.8].mean()
    assert report["gaussians_unseen"] == (asset.observations == 0).sum()
    np.testing.assert_allclose(report["extent"], toy.insertion.size, atol=0.3)
