from dataclasses import replace

import numpy as np
from toy_drive import CAR_COLOR, make_drive

from dwgs.reconstruct.views import evenly, paint_over, read_view, split_frames
from dwgs.scene.ground import Ground
from dwgs.scene.moving import static_points


def flat(drive):
    return Ground.from_sweeps(drive.sweeps, drive.ego)


def view(drive, i=0):
    return read_view(drive, drive.frames["front"][i], flat(drive), static_points(drive, drive.sweeps[i]))


def test_every_eighth_instant_judges_with_all_its_cameras(drive):
    names = ("front", "left")
    rig = replace(
        drive,
        frames={n: tuple(replace(f, index=f.index + 30) for f in drive.frames["front"]) for n in names},
    )
    teaching, judging = split_frames(rig)
    assert [f.index for f in judging] == [34, 34]
    assert len(teaching) == 16


def test_nothing_of_the_traffic_is_left_and_nothing_else_changed(drive):
    seen = view(drive)
    pixels = drive.frames["front"][0].pixels
    assert not (seen.pixels == CAR_COLOR).all(-1).any()
    assert (seen.pixels[~seen.hidden] == pixels[~seen.hidden]).all()
    assert not seen.hidden[seen.depth_pixels[:, 0], seen.depth_pixels[:, 1]].any()


def test_repainted_pixels_say_nothing_about_the_street(drive):
    frame = drive.frames["front"][0]
    painted = np.zeros((frame.camera.height, frame.camera.width), bool)
    painted[5:9, 5:9] = True
    seen = read_view(
        drive, replace(frame, load_reactive_mask=lambda: painted), flat(drive), np.zeros((0, 3), np.float32)
    )
    assert seen.hidden[painted].all()


def test_road_is_painted_as_road_and_a_wall_as_a_wall():
    drive = make_drive(frames=1)
    image = np.full((64, 96, 3), 200, np.uint8)
    image[29:] = 50
    hidden = np.zeros((64, 96), bool)
    hidden[20:50, 30:60] = True
    image[hidden] = 255
    painted = paint_over(image, hidden, drive.frames["front"][0].camera, flat(drive))
    assert (np.abs(painted[20:26, 30:60].astype(int) - 200) < 10).all()
    assert (np.abs(painted[40:50, 30:60].astype(int) - 50) < 10).all()
    assert (painted[~hidden] == image[~hidden]).all()


def test_half_a_view_sees_the_same_street(drive):
    seen = view(drive)
    half = seen.halved()
    assert half.pixels.shape == (half.camera.height, half.camera.width, 3) == (32, 48, 3)
    point = np.array([[12.0, 3, 0]])
    np.testing.assert_allclose(2 * half.camera.project(point)[0], seen.camera.project(point)[0])
    assert half.hidden[seen.hidden.reshape(32, 2, 48, 2).any((1, 3))].all()
    assert len(np.unique(half.depth_pixels, axis=0)) == len(half.depths) > 100


def test_evenly_keeps_both_ends():
    assert evenly(list(range(100)), 4) == [0, 33, 66, 99]
    assert evenly([1, 2], 4) == [1, 2]
