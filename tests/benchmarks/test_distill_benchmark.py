import json
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from rich.progress import Progress

from benchmarks import __main__ as command
from benchmarks.rivals.loops import Crops, FullFrames, Loop
from benchmarks.rivals.omnire import POINTS, RigidNode, Schedule
from benchmarks.workloads import distill, distill_poses, distill_rivals, distill_step
from benchmarks.workloads.distill import seconds_to
from benchmarks.workloads.drives import inserted
from benchmarks.workloads.reconstructed_street import oracle
from benchmarks.workloads.surfaces import cover
from dwgs.distill.config import GENERATED
from dwgs.distill.layers import FrozenBackground
from dwgs.distill.model import body_bounds
from dwgs.distill.shots import find_sights, prepare_shots
from dwgs.reconstruct import ReconstructConfig
from dwgs.scene import Gaussians, InputError
from dwgs.splat import Splats, View
from dwgs.street import build_street

QUIET = Progress(disable=True)
DRIVES = ("street", "near", "far", "overtaking", "parked")


@pytest.fixture(scope="module")
def street():
    return build_street(frames=8, width=96, height=64)


@pytest.fixture(scope="module")
def gaussian_world(street):
    """Video, background, insertion, and the frames ready to be learnt from."""
    insertion = street.insertion()
    scene, background = oracle(street, insertion, cover(street, 3000))
    frozen = FrozenBackground(background, ())
    sights = find_sights(scene, frozen, insertion, GENERATED, 1)
    fit = prepare_shots(sights, scene, frozen, insertion, body_bounds(insertion.size), 1)
    return SimpleNamespace(scene=scene, background=background, insertion=insertion, shots=run(fit))


def run(generator):
    while True:
        try:
            next(generator)
        except StopIteration as end:
            return end.value


def node(world, schedule, seed=0):
    bounds = body_bounds(world.insertion.size)
    return RigidNode(world.insertion.vehicle, Gaussians.empty(), bounds, 20.0, schedule, seed)


def test_time_to_quality_is_interpolated_between_schedules_and_bounded_beyond_them():
    bound, seconds = seconds_to(0.3, {10: 0.5, 40: 0.1})
    assert (bound, seconds) == ("", pytest.approx(20))
    assert seconds_to(0.3, {40: 0.4, 10: 0.5}) == ("_at_least", 40)
    assert seconds_to(0.3, {10: 0.2, 40: 0.1}) == ("_at_most", 10)


@pytest.mark.parametrize("drive", DRIVES)
def test_every_drive_covers_the_clip_and_the_vehicle_stands_on_the_road(street, drive):
    insertion = inserted(street, drive)
    insertion.trajectory.require([street.camera(i).time for i in range(street.frames)])
    heights = insertion.trajectory.world_from_vehicle[:, 2, 3]
    np.testing.assert_allclose(heights, insertion.size[2] / 2)


def test_the_command_knows_every_drive():
    assert command.Drive.__args__ == DRIVES


def test_quality_over_time_needs_a_reference_of_as_many_frames(street):
    with pytest.raises(InputError, match="of 193 frames, not 8; measure one"):
        distill.run(street, distill.Plan(["street"], [1.0], 0, 0), QUIET)


@pytest.mark.slow
def test_quality_over_time_is_measured_and_the_reference_kept(street, tmp_path, monkeypatch):
    monkeypatch.setattr(distill, "REFERENCE", tmp_path / "reference.json")
    distill.REFERENCE.write_text('{"street": {"frames": 193}}')
    metrics = distill.run(street, distill.Plan(["near"], [6.0], 12, 6.0), QUIET)
    value = {metric.key: metric.value for metric in metrics}
    kept = json.loads(distill.REFERENCE.read_text())
    assert kept["street"] == {"frames": 193}
    assert kept["near"] == {"psnr_roi_heldout": value["distill.street_near.psnr_converged"], "steps": 12, "frames": 8}
    gap = kept["near"]["psnr_roi_heldout"] - value["distill.street_near.psnr_at_6s"]
    assert value["distill.street_near.gap_db_at_6s"] == pytest.approx(gap)
    assert value["distill.street_near.shadow_gaussians"] > 10 * value["distill.street_near.shadow_gaussians_without"]


def test_noise_on_poses_is_found_again_and_nothing_else(street):
    truth = street.insertion().trajectory
    times = np.array([street.camera(i).time for i in range(street.frames)])
    assert np.abs(distill_poses.errors(truth, truth, times)).max() < 1e-9
    shaken = distill_poses.shake(truth, times, 0)
    off = distill_poses.errors(shaken, truth, times)
    noise = distill_poses.SHAKEN * np.random.default_rng(0).normal(size=(len(times), 6))
    np.testing.assert_allclose(off, noise, atol=1e-9)
    ahead = off + np.array([0, 0, 0, 1.0, 0, 0])
    left = {metric.key: metric.value for metric in distill_poses.left("x", ahead)}
    assert left["x.left_cm_along"] == pytest.approx(100 * np.sqrt(((off - np.median(off, 0))[:, 3] ** 2).mean()))
    assert left["x.shared_cm"] > 90


def test_noise_on_poses_is_measured_refined_and_as_it_is():
    street = build_street(frames=16, width=96, height=64)
    metrics = distill_poses.run(street, ["street"], steps=20, seeds=1, progress=QUIET)
    value = {metric.key.removeprefix("distill.street.poses."): metric.value for metric in metrics}
    assert value["moved_without_noise_cm"] == 0
    assert value["noise_0.psnr_refined"] != value["noise_0.psnr_unrefined"]
    assert value["psnr_true"] > value["noise_0.psnr_unrefined"]
    assert 0 < value["noise_0.left_cm"] < np.inf


def test_discs_lie_on_the_surfaces_of_the_street_as_many_as_asked_for(street):
    gaussians = cover(street, 2000).gaussians
    assert len(gaussians) == 2000
    triangles = np.concatenate([shape.corners for shape in street.stage.shapes[:2]])
    low, high = triangles.reshape(-1, 3).min(0), triangles.reshape(-1, 3).max(0)
    assert (gaussians.means >= low - 1e-3).all()
    assert (gaussians.means <= high + 1e-3).all()
    camera = street.camera(0)
    nearest = np.linalg.norm(gaussians.means - camera.position, axis=1)
    assert np.corrcoef(nearest, gaussians.scales[:, 0])[0, 1] > 0.3  # farther discs are larger


def test_a_larger_background_is_measured_against_a_smaller_one():
    street = build_street(frames=16, width=96, height=64)
    metrics = distill_step.run(street, [1000, 4000], QUIET, rounds=2)
    value = {metric.key: metric.value for metric in metrics}
    assert value["distill.background_4k.between"] > value["distill.background_1k.between"]
    assert 0.2 < value["distill.step_ratio_4k_over_1k"] < 5


def test_the_world_of_gaussians_is_its_background_where_no_vehicle_is(gaussian_world):
    frame = gaussian_world.scene.frames["front"][4]
    camera, frozen = frame.camera, FrozenBackground(gaussian_world.background, ())
    alone = frozen.freeze(camera, "front", (0.0, 0.0)).alone(View.from_camera(camera)).clamp(0, 1).numpy()
    error = np.abs(alone - frame.pixels / 255)
    assert error[~frame.reactive_mask].max() < 1 / 255
    assert error[frame.reactive_mask].mean() > 0.05


def test_rivals_begin_where_omnire_does(gaussian_world):
    splats = node(gaussian_world, Schedule()).splats(1)
    assert len(splats) == POINTS
    assert splats.sh.shape[1] == 1
    torch.testing.assert_close(splats.opacities, torch.full((POINTS,), 0.1))
    torch.testing.assert_close(splats.scales[:, 0], splats.scales[:, 2])


def test_what_happens_at_a_step_happens_in_proportion_in_a_shorter_schedule():
    whole, tenth = Schedule(30_000, 100), Schedule(3000, 100)
    for event in ("refines", "resets"):
        steps = [step for step in range(1, 30_001) if getattr(whole, event)(step)]
        shorter = [step for step in range(1, 3001) if getattr(tenth, event)(step)]
        assert shorter == [step // 10 for step in steps]
        assert steps[0] == {"refines": 600, "resets": 3100}[event]
    assert [whole.shrink(step) for step in (1, 251, 501, 30_000)] == [4, 2, 1, 1]
    assert [whole.degree(step) for step in (1, 1000, 3000, 30_000)] == [0, 1, 3, 3]


def test_both_rivals_see_the_same_background_and_should_see_the_same_video(gaussian_world):
    splats = node(gaussian_world, Schedule()).splats(1)
    nothing = replace(splats, opacities=0 * splats.opacities)
    shots = gaussian_world.shots[:1]
    window = shots[0].sight.region.window
    full, whole, _ = FullFrames(shots, gaussian_world.background, 1).draw(0, 1, nothing)
    crop, part, _ = Crops(shots, 1).draw(0, 1, nothing)
    torch.testing.assert_close(part, window.of(whole), rtol=0, atol=1e-6)
    assert (crop - window.of(full)).abs().max() < 0.02  # the whole frame's sky is interpolated


def test_a_rival_learns_grows_and_stays_in_bounds(gaussian_world):
    schedule = Schedule(200, 1)
    loop = Loop(node(gaussian_world, schedule), Crops(gaussian_world.shots, 1), schedule)
    flat = Crops(gaussian_world.shots, 1)
    before = distill_rivals.flat_psnr(loop.splats(), flat, gaussian_world.shots)
    counts = []
    for _ in range(150):
        loop.step()
        counts.append(len(loop.node))
    assert distill_rivals.flat_psnr(loop.splats(), flat, gaussian_world.shots) > before + 1
    assert len(set(counts)) > 3
    splats = loop.splats()
    assert all(torch.isfinite(getattr(splats, f.name)).all() for f in fields(Splats))
    assert not splats.means.requires_grad


def test_a_rival_in_time_has_a_time_and_one_too_late_a_bound():
    class Fake:
        steps = 0
        node = ()
        schedule = Schedule(30)

        def step(self):
            self.steps += 1

    fake = Fake()
    reached = distill_rivals.chase(fake, lambda: fake.steps / 10, 1.0, 0.02, QUIET, "fake")
    assert reached.is_reached
    assert reached.psnr >= 1.0
    late = distill_rivals.chase(Fake(), lambda: 0.0, 1.0, 0.02, QUIET, "late")
    assert not late.is_reached
    keys = [metric.key for metric in distill_rivals._metrics("crop_loop", late, 0.01)]
    assert "distill.street.speedup_over_crop_loop_at_least" in keys
    assert "distill.street.speedup_over_crop_loop" not in keys


@pytest.mark.slow
def test_ours_and_the_rivals_race_for_the_same_quality(street):
    race = distill_rivals.Race(8.0, 1.0, 300, ReconstructConfig(steps=4, gaussians=2000, grown=100))
    value = {metric.key: metric.value for metric in distill_rivals.run(street, race, QUIET)}
    assert value["distill.street.rivals.our_steps"] > 0
    for name in ("crop_loop", "field_loop"):
        assert value[f"distill.street.{name}.steps"] > 0
        speedups = [key for key in value if key.startswith(f"distill.street.speedup_over_{name}")]
        assert len(speedups) == 1
