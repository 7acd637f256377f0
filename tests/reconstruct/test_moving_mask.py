import numpy as np
from toy_drive import CAR_COLOR, make_drive

from dwgs.reconstruct import moving_mask


def test_no_pixel_of_a_moving_car_is_left_unmasked(drive):
    for frame in drive.frames["front"]:
        red = (frame.pixels == CAR_COLOR).all(-1)
        mask = moving_mask(drive, frame)
        assert red.any()
        assert mask[red].all()
        assert mask.sum() < 4 * red.sum()


def test_the_shadow_on_the_ground_is_masked_farther_than_the_body(drive):
    frame = drive.frames["front"][0]
    columns = [np.flatnonzero(row) for row in moving_mask(drive, frame, margin=0)]
    widths = [c[-1] - c[0] + 1 for c in columns if len(c)]
    assert max(widths) > 1.2 * widths[0]


def test_a_parked_car_is_part_of_the_street(drive):
    from dataclasses import replace

    parked = replace(drive, tracks=(replace(drive.tracks[0], is_moving=False),))
    assert not moving_mask(parked, drive.frames["front"][0]).any()


def test_a_street_without_tracks_has_no_mask():
    drive = make_drive(frames=2, traffic=False)
    assert not moving_mask(drive, drive.frames["front"][0]).any()
