from dataclasses import replace

import numpy as np
from toy_drive import CAR_SIZE, make_drive

from dwgs.reconstruct.static_points import depth_samples, static_points
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import transform_points


def test_points_on_a_moving_car_are_dropped_each_at_its_own_time(drive):
    track, sweep = drive.tracks[0], drive.sweeps[3]
    rng = np.random.default_rng(0)
    times = rng.uniform(sweep.time - 0.1, sweep.time, 200)
    on_car = np.concatenate(
        [transform_points(track.trajectory.at(t), (rng.uniform(-0.5, 0.5, 3) * CAR_SIZE)[None]) for t in times]
    )
    both = replace(
        sweep,
        points=np.concatenate([sweep.points, on_car.astype(np.float32)]),
        times=np.concatenate([sweep.times, times]),
    )
    kept = static_points(drive, both)
    assert len(kept) > 0.9 * len(sweep.points)
    assert not (kept[:, None] == on_car.astype(np.float32)[None]).all(-1).any()


def test_people_noise_and_nan_are_not_the_street():
    drive = make_drive(frames=1, traffic=False)
    sweep = drive.sweeps[0]
    labels = np.zeros(len(sweep.points), np.uint8)
    labels[:10], labels[10:20] = SURFACES.index("person"), SURFACES.index("noise")
    points = sweep.points.copy()
    points[20:30] = np.nan
    kept = static_points(drive, replace(sweep, points=points, labels=labels))
    np.testing.assert_array_equal(kept, sweep.points[30:])


def test_a_depth_hidden_by_something_nearer_is_no_sample(drive):
    camera = drive.frames["front"][0].camera
    wall = np.array([[20, y, z] for y in np.linspace(-2, 2, 60) for z in np.linspace(0.5, 2.5, 40)], np.float32)
    pixels, depths = depth_samples(
        np.concatenate([wall, wall * [0.4, 0.4, 0.4] + [0, 0, 0.9]]).astype(np.float32), camera
    )
    assert len(np.unique(pixels, axis=0)) == len(pixels)
    np.testing.assert_allclose(depths, 8, atol=1e-4)
