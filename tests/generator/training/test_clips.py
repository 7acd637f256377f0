"""Clips of two vehicles of the embedded street."""

from dataclasses import replace

import numpy as np
import pytest

from dwgs.scene import InputError
from dwgs.street import build_street
from generator.training.clips import clips_of
from generator.training.config import ClipConfig

CLIPS = ClipConfig(frames=9, strides=(1,), hop=4)


@pytest.fixture(scope="module")
def drive():
    scene = build_street(frames=9, width=48, height=32).scene()
    return replace(scene, tracks=tuple(t for t in scene.tracks if t.id in ("moving-00", "parked-04")))


def test_a_clip_of_whole_frames_is_of_the_same_vehicle_and_tells_of_all(drive):
    ours, whole = (list(clips_of(drive, replace(CLIPS, whole_frame=on))) for on in (False, True))
    assert [clip.name for clip in whole] == [clip.name for clip in ours]
    assert len(ours) >= 1
    for before, after in zip(ours[0].frames, whole[0].frames, strict=True):
        assert after.frame is before.frame
        assert after.load_reactive_mask().all()
        assert not before.load_reactive_mask().all()
        assert np.count_nonzero(after.load_point_mask()) > 4 * np.count_nonzero(before.load_point_mask())


def test_whole_frames_are_not_drawn_with_pixels():
    with pytest.raises(InputError, match="leave --points or --whole-frame out"):
        replace(CLIPS, whole_frame=True, points="pixels")
