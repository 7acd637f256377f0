from dataclasses import replace

import numpy as np
from toy_drive import CAR_COLOR, CAR_SIZE

from dwgs.reconstruct.movers import FEW_POINTS, GROUND_BAND, box_surface, find_movers, hits_on_movers, unmask
from dwgs.reconstruct.traffic import Traffic
from dwgs.reconstruct.views import read_view
from dwgs.scene import Trajectory
from dwgs.scene.ground import Ground
from dwgs.scene.moving import static_points
from dwgs.scene.pose import transform_points


def with_hits(drive, count=100):
    """The drive, whose LiDAR hits the back of the car, too."""
    (car,) = drive.tracks
    rng = np.random.default_rng(0)
    on_back = np.column_stack([np.full(count, -0.5), rng.uniform(-0.4, 0.4, (count, 2))]) * CAR_SIZE
    sweeps = []
    for sweep in drive.sweeps:
        world = transform_points(car.trajectory.at(sweep.time), on_back).astype(np.float32)
        points, times = np.concatenate([sweep.points, world]), np.append(sweep.times, np.full(count, sweep.time))
        sweeps.append(replace(sweep, points=points, times=times))
    return replace(drive, sweeps=tuple(sweeps)), on_back


def views_of(drive):
    ground, hits = Ground.from_sweeps(drive.sweeps, drive.ego), {}
    views = []
    for frame, sweep in zip(drive.frames["front"], drive.sweeps, strict=True):
        hits[frame.index] = hits_on_movers(drive, sweep)
        masked = read_view(drive, frame, ground, static_points(drive, sweep))
        views.append(unmask(masked, hits[frame.index], {t.id: t.trajectory for t in drive.tracks}))
    return views, hits


def test_hits_are_found_in_the_frame_of_the_box_above_the_ground(drive):
    shaken, on_back = with_hits(drive)
    hits = hits_on_movers(shaken, shaken.sweeps[3])["car"]
    assert (hits[:, 2] > GROUND_BAND - CAR_SIZE[2] / 2).all()
    above = on_back[on_back[:, 2] > GROUND_BAND - CAR_SIZE[2] / 2]
    np.testing.assert_allclose(hits[-len(above) :], above, atol=1e-4)


def test_an_unmasked_view_is_what_was_recorded_with_the_depth_of_the_traffic(drive):
    shaken, _ = with_hits(drive)
    views, _ = views_of(shaken)
    for view, frame in zip(views, drive.frames["front"], strict=True):
        assert (view.pixels == frame.pixels).all()
        assert not view.hidden.any()
        on_car = (view.pixels == CAR_COLOR).all(-1)[view.depth_pixels[:, 0], view.depth_pixels[:, 1]]
        assert on_car.sum() > 20
        np.testing.assert_allclose(view.depths[on_car], 9 - CAR_SIZE[0] / 2, atol=0.05)


def test_where_a_generator_painted_no_depth_is_known(drive):
    frame, sweep = drive.frames["front"][0], drive.sweeps[0]
    painted = np.zeros((frame.camera.height, frame.camera.width), bool)
    painted[30:60, 30:70] = True
    frame = replace(frame, load_reactive_mask=lambda: painted)
    view = read_view(drive, frame, Ground.from_sweeps(drive.sweeps, drive.ego), static_points(drive, sweep))
    seen = unmask(view, hits_on_movers(drive, sweep), {"car": drive.tracks[0].trajectory})
    assert len(seen.depths) > 50
    assert not painted[seen.depth_pixels[:, 0], seen.depth_pixels[:, 1]].any()


def test_points_of_a_mover_have_the_colours_of_the_frames(drive):
    shaken, _ = with_hits(drive)
    car = find_movers(shaken, *views_of(shaken))["car"]
    assert len(car.vehicle.points) > FEW_POINTS
    assert np.median(np.abs(car.vehicle.colors.astype(int) - CAR_COLOR), axis=0).max() == 0


def test_a_track_with_hardly_any_points_is_given_the_surface_of_its_box(drive):
    car = find_movers(drive, *views_of(drive))["car"]
    assert len(car.vehicle.points) > FEW_POINTS
    assert (np.abs(car.vehicle.points) <= CAR_SIZE / 2 + 0.26).all()


def test_what_stands_still_or_is_never_seen_is_no_mover(drive):
    views, hits = views_of(drive)
    parked = replace(drive, tracks=(replace(drive.tracks[0], is_moving=False),))
    assert find_movers(parked, views, hits) == {}
    away = np.eye(4)
    away[0, 3] = -100
    gone = replace(drive.tracks[0], trajectory=drive.tracks[0].trajectory.moved(away))
    assert find_movers(replace(drive, tracks=(gone,)), views, {}) == {}


def test_the_surface_of_a_box_has_no_bottom():
    points = box_surface(CAR_SIZE, 0.2)
    scaled = np.abs(points / CAR_SIZE)
    np.testing.assert_allclose(scaled.max(1), 0.5)
    assert (points[:, 2] > -CAR_SIZE[2] / 2).all()
    for axis, side in ((0, -0.5), (0, 0.5), (1, -0.5), (1, 0.5), (2, 0.5)):
        assert (np.abs(points[:, axis] - side * CAR_SIZE[axis]) < 1e-9).sum() > 20


def test_seedlings_belong_to_the_box_they_stand_in(drive):
    views, hits = views_of(drive)
    traffic = Traffic(find_movers(drive, views, hits), [view.frame for view in views])
    (_, body), (_, shadow) = traffic.begin()
    world = replace(body, means=transform_points(drive.tracks[0].trajectory.at(0.3), body.means).astype(np.float32))
    (street, left), (group, taken) = traffic.adopt(3, world)
    assert (street.owner, group.owner) == (-1, 0)
    assert len(left) == 0
    np.testing.assert_allclose(taken.means, body.means, atol=1e-5)
    assert len(shadow) > 100


def test_what_is_not_there_stands_behind_the_camera(drive):
    views, hits = views_of(drive)
    movers = find_movers(drive, views, hits)
    whole = movers["car"].trajectory
    begin = Trajectory(whole.times[:3], whole.world_from_vehicle[:3])
    traffic = Traffic({"car": replace(movers["car"], trajectory=begin)}, [view.frame for view in views])
    for i, view in enumerate(views):
        depth = (view.camera.camera_from_world @ traffic.poses(i)[0].detach().numpy())[2, 3]
        assert (depth < 0) == (i > 3)  # seen a little longer than annotated
