import json
from dataclasses import replace

import numpy as np
import pytest
from toy_drive import CAR_COLOR, CAR_SIZE, make_drive

from dwgs.metrics import psnr
from dwgs.optimize import Evaluated, Grown, Preparing, Step
from dwgs.reconstruct import INSERTED, ReconstructConfig, Reconstruction, reconstruct, reconstruct_jointly
from dwgs.reconstruct.movers import box_surface
from dwgs.reconstruct.worst import picture_of_worst
from dwgs.scene import InputError, Insertion, Trajectory, VehiclePoints
from dwgs.scene.pose import pose
from dwgs.scene.silhouette import box_silhouette

CONFIG = ReconstructConfig(steps=80, gaussians=4000, grown=300, threads=1)


def follow(run):
    """(what it returns, its report, events)."""
    events = []
    while True:
        try:
            events.append(next(run))
        except StopIteration as stop:
            return *stop.value, events


@pytest.fixture(scope="module")
def fitted(drive):
    return follow(reconstruct_jointly(drive, CONFIG))


def psnr_of_car(reconstruction, scene, frames):
    """Over the pixels that show the red car."""
    scores = []
    for frame in frames:
        target = frame.pixels / 255
        scores.append(psnr(reconstruction.show(frame), target, (frame.pixels == CAR_COLOR).all(-1)))
    return np.mean(scores)


def test_a_moving_vehicle_is_explained_where_the_static_street_cannot(drive, fitted):
    reconstruction, report, _ = fitted
    background, _, _ = follow(reconstruct(drive, CONFIG))
    frames = drive.frames["front"]
    alone = psnr_of_car(Reconstruction(background, ()), drive, frames)
    assert psnr_of_car(reconstruction, drive, frames) > alone + 15
    assert report["actors"][0]["psnr_train"] > 30
    assert report["psnr_train"] > 29


def test_one_tells_how_it_goes(fitted):
    events = fitted[2]
    assert {type(event) for event in events} == {Preparing, Grown, Step, Evaluated}
    assert [e.step for e in events if isinstance(e, Step)] == list(range(1, CONFIG.steps + 1))
    assert isinstance(events[-1], Evaluated)
    assert events[-1].psnr == fitted[1]["psnr_train"]


def test_the_report_says_where_it_fails(drive, fitted):
    reconstruction, report, _ = fitted
    json.dumps(report, allow_nan=False)
    assert [f["frame"] for f in report["frames"]] == list(range(9))
    assert [f["heldout"] for f in report["frames"]] == [i == 4 for i in range(9)]
    taught = [f["psnr"] for f in report["frames"] if not f["heldout"]]
    assert [f["psnr"] for f in report["worst"]] == [*sorted(taught)[:2], report["frames"][4]["psnr"]]
    assert report["psnr_train"] == pytest.approx(np.mean(taught), abs=1e-3)
    assert report["cameras"]["front"]["psnr_heldout"] == report["psnr_heldout"] == report["frames"][4]["psnr"]
    (car,) = report["actors"]
    assert (car["id"], car["category"], car["frames"]) == ("car", "Car", 9)
    assert reconstruction.actors[0].asset.quality == car
    assert 0 < car["pose_correction_rms_m"] < 0.1
    picture = picture_of_worst(reconstruction, drive, report)
    first = report["worst"][0]["frame"]
    height, width = 64, 96
    assert (picture[:height, :width] == drive.frames["front"][first].pixels).all()
    assert picture.dtype == np.uint8
    assert picture.shape[0] > 3 * height


def test_a_body_stays_in_its_box_and_a_shadow_on_the_ground(fitted):
    (car,) = fitted[0].actors
    assert len(car.asset.body) > 50
    assert (np.abs(car.asset.body.means) < CAR_SIZE / 2 + 0.26).all()
    assert np.ptp(car.asset.shadow.means[:, 2]) < 1e-5
    assert car.trajectory.covers([0.0, 0.8]).all()


def test_the_same_drive_gives_the_same_bytes_on_any_number_of_threads(drive, fitted):
    again = follow(reconstruct_jointly(drive, replace(CONFIG, threads=2)))[0]
    clouds = [[w.background.gaussians, *(a.asset.gaussians for a in w.actors)] for w in (fitted[0], again)]
    for ours, theirs in zip(*clouds, strict=True):
        for name in ("means", "quats", "scales", "opacities", "sh"):
            assert getattr(ours, name).tobytes() == getattr(theirs, name).tobytes()


def test_boxes_that_were_annotated_badly_are_put_right():
    drive = make_drive()
    (car,) = drive.tracks
    noise = np.random.default_rng(1).normal(0, 0.15, (9, 3)) * [0, 1, 1]
    poses = car.trajectory.world_from_vehicle.copy()
    poses[:, :3, 3] += noise
    shaken = replace(drive, tracks=(replace(car, trajectory=Trajectory(car.trajectory.times, poses)),))
    reconstruction, _, _ = follow(reconstruct_jointly(shaken, replace(CONFIG, steps=250)))
    taught = [i for i in range(9) if i != 4]
    times = car.trajectory.times[taught]
    left = (reconstruction.actors[0].trajectory.at(times) - car.trajectory.at(times))[:, :3, 3]

    def scatter(offsets):  # where the box sits on the car makes no difference
        return np.linalg.norm((offsets - offsets.mean(0))[:, 1:], axis=1).mean()

    assert scatter(left) < 0.5 * scatter(noise[taught])


def test_a_vehicle_that_a_generator_put_in_is_an_actor_too():
    drive = make_drive(traffic=False)
    poses = np.array([pose(np.eye(3), [0.5 * i + 9, 0.5, CAR_SIZE[2] / 2]) for i in range(9)])
    trajectory = Trajectory(np.arange(9) / 10, poses)

    def painted(frame):
        mask = box_silhouette(frame.camera, trajectory.at(frame.camera.time), CAR_SIZE)
        pixels = frame.pixels.copy()
        pixels[mask] = CAR_COLOR
        return replace(frame, load_pixels=lambda: pixels, load_reactive_mask=lambda: mask)

    edited = replace(drive, frames={"front": tuple(painted(f) for f in drive.frames["front"])})
    points = box_surface(CAR_SIZE, 0.2).astype(np.float32)
    vehicle = VehiclePoints(points, np.tile(np.uint8([200, 30, 30]), (len(points), 1)))
    insertion = Insertion(vehicle, CAR_SIZE, trajectory)
    reconstruction, report, _ = follow(reconstruct_jointly(edited, CONFIG, insertion))
    assert [actor.id for actor in reconstruction.actors] == [INSERTED]
    assert psnr_of_car(reconstruction, edited, edited.frames["front"]) > 25
    assert report["actors"][0]["psnr_train"] > 25
    short = replace(insertion, trajectory=Trajectory(trajectory.times[:5], poses[:5]))
    with pytest.raises(InputError, match=r"trajectory covers 0.00-0.40 s but frame 5"):
        follow(reconstruct_jointly(edited, CONFIG, short))


def test_without_traffic_the_street_alone_is_scored():
    reconstruction, report, _ = follow(
        reconstruct_jointly(make_drive(frames=5, traffic=False), replace(CONFIG, steps=30))
    )
    assert reconstruction.actors == ()
    assert report["actors"] == []
    assert report["psnr_train"] > 24
    assert report["frames"][0]["psnr_actors"] is None


def test_without_lidar_the_message_says_what_is_missing(drive):
    with pytest.raises(InputError, match="'toy' has no LiDAR sweep"):
        follow(reconstruct_jointly(replace(drive, sweeps=()), CONFIG))
