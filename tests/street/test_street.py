import hashlib
import importlib.util
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dwgs.scene import InputError
from dwgs.scene.lidar import SURFACES
from dwgs.scene.pose import inverse, transform_points
from dwgs.street import build_street
from dwgs.street.render import render

FRAMES, WIDTH, HEIGHT = 4, 96, 64


@pytest.fixture(scope="module")
def street():
    return build_street(seed=0, frames=FRAMES, width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def scene(street):
    return street.scene()


@pytest.fixture(scope="module")
def insertion(street):
    return street.insertion()


@pytest.fixture(scope="module")
def oracle(street, insertion):
    return street.oracle(insertion)


def digest(scene):
    data = hashlib.sha256()
    for frame in scene.frames["front"]:
        data.update(frame.pixels.tobytes())
        data.update(frame.camera.world_from_camera.tobytes())
    for sweep in scene.sweeps:
        data.update(sweep.points.tobytes() + sweep.times.tobytes())
    return data.hexdigest()


def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_street(scene):
    assert digest(build_street(seed=0, frames=FRAMES, width=WIDTH, height=HEIGHT).scene()) == digest(scene)
    assert digest(build_street(seed=1, frames=FRAMES, width=WIDTH, height=HEIGHT).scene()) != digest(scene)


def test_threads_change_no_byte(street):
    camera = street.camera(1)
    with ThreadPoolExecutor(2) as executor:
        by_two = render(street.stage, camera, executor=executor).pixels
    assert np.array_equal(by_two, render(street.stage, camera).pixels)


def test_rendering_all_frames_ahead_gives_the_bytes_of_rendering_each_when_asked(scene):
    ahead = build_street(seed=0, frames=FRAMES, width=WIDTH, height=HEIGHT)
    heard = []
    ahead.render_all(lambda done, total: heard.append((done, total)))
    assert heard == [(done, FRAMES) for done in range(1, FRAMES + 1)]
    for frame in scene.frames["front"]:
        assert np.array_equal(ahead.pixels(frame.index), frame.pixels)


def test_a_crop_shows_the_pixels_of_the_whole(street):
    camera = street.camera(1)
    whole = render(street.stage, camera).pixels
    crop = render(street.stage, camera.crop(20, 10, 40, 30)).pixels
    assert np.array_equal(crop[1:-1, 1:-1], whole[11:39, 21:59])  # edges are judged by neighbours


def test_depth_agrees_with_lidar(street, scene):
    frame, sweep = scene.frames["front"][2], scene.sweeps[2]
    large = frame.camera.resize(720, 480)
    depth = street.view(large, large.time).depth
    is_near = np.abs(sweep.times - large.time) < 0.01
    pixels, z = large.project(sweep.points[is_near])
    column, row = np.floor(pixels).astype(int).T
    inside = (z > 1) & (column >= 0) & (column < 720) & (row >= 0) & (row < 480)
    error = np.abs(depth[row[inside], column[inside]] - z[inside]) / z[inside]
    assert inside.sum() > 2000
    assert np.median(error) < 0.005
    assert (error < 0.05).mean() > 0.85  # the sensor sits apart from the camera: edges differ


def test_depth_of_a_frame_is_that_of_its_camera_and_infinite_in_the_sky(street):
    depth = street.depth(0)
    assert depth.shape == (HEIGHT, WIDTH)
    assert depth.dtype == np.float32
    assert np.isinf(depth[0, WIDTH // 2])
    camera = street.camera(0)
    below = camera.world_from_camera[:3, :3] @ np.linalg.solve(camera.K, [WIDTH / 2 + 0.5, HEIGHT - 0.5, 1])
    expected = camera.position[2] / -below[2]  # the road is z = 0 there
    assert depth[-1, WIDTH // 2] == pytest.approx(expected, rel=2e-3)


def test_camera_time_is_the_middle_of_its_sweep_and_everything_covers_it(scene):
    for frame, sweep in zip(scene.frames["front"], scene.sweeps, strict=True):
        assert sweep.frame_index == frame.index
        assert sweep.times.min() >= sweep.time - 0.1
        assert sweep.times.max() <= sweep.time
        assert frame.camera.time == pytest.approx(sweep.time - 0.05)
        assert scene.ego.covers(frame.camera.time)
        assert scene.ego.covers(sweep.time)
        assert all(track.trajectory.covers(sweep.time) for track in scene.tracks)
        ego_from_camera = inverse(scene.ego.at(frame.camera.time)) @ frame.camera.world_from_camera
        assert ego_from_camera[2, 3] == pytest.approx(1.6)
        assert ego_from_camera[0, 2] == pytest.approx(1)  # it looks ahead


def test_points_on_vehicles_lie_in_track_boxes_at_the_time_they_were_hit(scene):
    sweep = scene.sweeps[1]
    on_vehicle = np.flatnonzero(sweep.labels == SURFACES.index("vehicle"))
    boxed = np.zeros(len(on_vehicle), bool)
    found = {True: 0, False: 0}
    for track in scene.tracks:
        poses = inverse(track.trajectory.at(sweep.times[on_vehicle]))
        local = np.einsum("nij,nj->ni", poses[:, :3, :3], sweep.points[on_vehicle]) + poses[:, :3, 3]
        inside = (np.abs(local) < track.size / 2 + [0.06, 0.20, 0.06]).all(1)  # mirrors reach out
        boxed |= inside
        found[track.is_moving] += int(inside.sum())
    assert boxed.all()
    assert found[True] > 20
    assert found[False] > 1000


def test_points_of_the_road_lie_on_the_road(scene):
    sweep = scene.sweeps[0]
    ground = sweep.points[sweep.labels == SURFACES.index("ground")]
    x, y, _ = ground.T
    on_road = ground[(x > -50) & (y > -3.8) & (y < 10.6)]
    assert len(on_road) > 5000
    assert np.abs(on_road[:, 2]).max() < 0.06


def test_only_moving_tracks_move(scene):
    assert {track.is_moving for track in scene.tracks} == {True, False}
    for track in scene.tracks:
        assert (track.trajectory.length > 0.8) == track.is_moving


def test_the_oracle_differs_from_the_recording_only_inside_the_reactive_mask(scene, oracle):
    for recorded, edited in zip(scene.frames["front"], oracle.frames["front"], strict=True):
        differs = (recorded.pixels != edited.pixels).any(2)
        mask = edited.reactive_mask
        assert differs.any()
        assert not (differs & ~mask).any()
        assert mask.mean() < 0.5
        assert recorded.reactive_mask is None


def test_the_oracle_renders_the_bytes_of_a_whole_render(street, insertion, oracle):
    stage = street.with_vehicle(insertion.trajectory)
    for frame in oracle.frames["front"]:
        assert np.array_equal(frame.pixels, render(stage, frame.camera).pixels)


def test_the_oracle_refuses_a_trajectory_that_ends_early(street, insertion):
    early = street.ego.at([0.0, 0.1])
    short = replace(
        insertion,
        trajectory=replace(insertion.trajectory, times=np.array([0, 0.1]), world_from_vehicle=early),
    )
    with pytest.raises(InputError, match="trim the clip or extend the trajectory"):
        street.oracle(short)


def test_the_shadow_falls_away_from_the_sun(street, insertion):
    camera = street.camera(1)
    world_from_vehicle = insertion.trajectory.at(camera.time)
    sun = np.array(street.stage.world.sun)
    across = np.array([0, np.sign(sun[1]), 0])  # the side of the car that the sun is on
    size = insertion.size
    sides = {}
    for name, sign in (("lit", 1), ("shadow", -1)):
        point = world_from_vehicle[:3, 3] + sign * across * (size[1] / 2 + 0.45)
        above = np.array([[0, 1, 0, point[0]], [1, 0, 0, point[1]], [0, 0, -1, 1.2], [0, 0, 0, 1.0]])
        down = replace(camera, K=np.array([[60, 0, 8], [0, 60, 8], [0, 0, 1.0]]), width=16, height=16).at(above)
        empty = street.view(down, camera.time).rgb.astype(float).mean()
        sides[name] = street.view(down, camera.time, insertion).rgb.astype(float).mean() / empty
    assert sides["lit"] > 0.85
    assert sides["shadow"] < 0.75


def test_the_vehicle_alone_stands_on_grey_where_its_alpha_is_zero(street, insertion):
    camera = street.camera(0).resize(180, 120)
    view = street.vehicle_view(camera, insertion, camera.time)
    nothing = view.vehicle_alpha == 0
    assert (view.rgb[nothing] == 127).all()
    assert np.isinf(view.depth[nothing]).all()
    assert (view.vehicle_alpha == 1).sum() > 200
    assert ((view.vehicle_alpha > 0) & (view.vehicle_alpha < 1)).any()


def test_vehicle_points_lie_in_the_box_and_face_outwards(street):
    vehicle, size = street.vehicle
    assert vehicle.is_complete
    assert vehicle.normals is not None
    np.testing.assert_allclose(np.linalg.norm(vehicle.normals, axis=1), 1, atol=1e-4)
    assert (np.abs(vehicle.points) <= size / 2 + [0.02, 0.15, 0.02]).all()  # mirrors reach out
    assert vehicle.points[:, 2].min() == pytest.approx(-size[2] / 2, abs=0.02)  # wheels on the ground
    top = vehicle.points[:, 2] > 0.45 * size[2]
    assert vehicle.normals[top, 2].mean() > 0.8


def test_the_default_insertion_meets_no_other_vehicle():
    street = build_street(seed=0, frames=193, width=8, height=8)
    trajectory = street.insertion().trajectory
    for time in np.arange(0.05, 19.3, 0.2):
        vehicle_from_world = inverse(trajectory.at(time))
        for other in street.plan.movers + street.plan.parked:
            centre = transform_points(vehicle_from_world, other.trajectory.at(time)[None, :3, 3])[0]
            assert abs(centre[0]) > 4.8 or abs(centre[1]) > 2.0


def test_a_street_without_frames_is_refused():
    with pytest.raises(InputError, match="at least one frame"):
        build_street(frames=0)


def test_the_street_looks_as_it_did_when_last_approved():
    folder = Path(__file__).parents[1] / "golden"
    spec = importlib.util.spec_from_file_location("make_street", folder / "make_street.py")
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    golden = np.asarray(Image.open(maker.GOLDEN), np.float64)
    error = ((maker.golden_frame() - golden) ** 2).mean()
    assert 10 * np.log10(255**2 / max(error, 1e-9)) > 38, "look at the frame; if it is meant, run make_street.py"
