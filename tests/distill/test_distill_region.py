from dataclasses import replace

import numpy as np
from toy_street import SIZE

from dwgs.distill.region import MARGIN, find_region, visible_fraction
from dwgs.scene import Track, Trajectory
from dwgs.scene.pose import pose
from dwgs.scene.silhouette import box_silhouette


def whole(region, shape):
    mask = np.zeros(shape, bool)
    region.window.of(mask)[:] = region.supervised
    return mask


def region_of(toy, index=5, is_generated=True, tracks=()):
    frame = toy.frame(index, is_generated=is_generated)
    world_from_vehicle = toy.insertion.trajectory.at(frame.camera.time)
    return frame, find_region(frame, frame.camera, world_from_vehicle, toy.insertion, tracks)


def track_at(position, is_moving=True):
    trajectory = Trajectory(np.array([0.0, 10.0]), np.tile(pose(np.eye(3), position), (2, 1, 1)))
    return Track("other", "Car", SIZE, trajectory, is_moving)


def test_a_generated_frame_teaches_its_reactive_mask_and_a_rim(toy):
    frame, region = region_of(toy)
    supervised = whole(region, (64, 96))
    assert supervised[frame.reactive_mask].all()
    rim = supervised & ~frame.reactive_mask
    y, x = np.nonzero(rim)
    masked = np.argwhere(frame.reactive_mask)
    nearest = np.sqrt(((np.column_stack([y, x])[:, None] - masked) ** 2).sum(-1)).min(1)
    assert nearest.max() <= MARGIN
    assert region.reactive.sum() == frame.reactive_mask.sum()


def test_a_recorded_frame_teaches_the_box_and_a_rim(toy):
    frame, region = region_of(toy, is_generated=False)
    box = box_silhouette(frame.camera, toy.insertion.trajectory.at(frame.camera.time), SIZE, MARGIN)
    np.testing.assert_array_equal(whole(region, (64, 96)), box)
    assert not region.reactive.any()


def test_the_vehicles_own_track_takes_nothing_away(toy):
    own = replace(track_at([0, 0, 0]), trajectory=toy.insertion.trajectory)
    _, alone = region_of(toy, is_generated=False)
    _, region = region_of(toy, is_generated=False, tracks=[own])
    np.testing.assert_array_equal(region.supervised, alone.supervised)


def test_traffic_before_the_vehicle_teaches_nothing(toy):
    camera = toy.cameras[5]
    near = track_at([6, 0.2, 0.75])
    _, region = region_of(toy, tracks=[near])
    covered = box_silhouette(camera, near.trajectory.at(camera.time), SIZE)
    assert not (whole(region, (64, 96)) & covered).any()


def test_traffic_behind_the_vehicle_teaches_where_the_vehicle_covers_it(toy):
    camera = toy.cameras[5]
    far = track_at([16, -1.5, 0.75])
    _, region = region_of(toy, tracks=[far])
    covered = box_silhouette(camera, far.trajectory.at(camera.time), SIZE)
    world_from_vehicle = toy.insertion.trajectory.at(camera.time)
    supervised = whole(region, (64, 96))
    assert (covered & box_silhouette(camera, world_from_vehicle, SIZE)).sum() > 50
    assert not (supervised & covered & ~box_silhouette(camera, world_from_vehicle, SIZE, 2)).any()
    assert supervised[box_silhouette(camera, world_from_vehicle, 0.95 * SIZE)].all()


def test_traffic_that_runs_into_a_generated_vehicle_teaches_nothing(toy):
    camera = toy.cameras[5]
    inside = replace(track_at([0, 0, 0]), trajectory=toy.insertion.trajectory)
    _, region = region_of(toy, tracks=[inside])
    supervised = whole(region, (64, 96))
    assert not (supervised & box_silhouette(camera, inside.trajectory.at(camera.time), SIZE)).any()


def test_parked_cars_are_background(toy):
    _, alone = region_of(toy)
    _, region = region_of(toy, tracks=[track_at([6, 0.2, 0.75], is_moving=False)])
    np.testing.assert_array_equal(region.supervised, alone.supervised)


def test_a_frame_without_the_vehicle_has_no_region(toy):
    frame = toy.frame(5, is_generated=False)
    behind = pose(np.eye(3), [-10, 0, 0.75])
    assert find_region(frame, frame.camera, behind, toy.insertion, ()) is None
    assert visible_fraction(frame.camera, behind, toy.insertion) == 0
