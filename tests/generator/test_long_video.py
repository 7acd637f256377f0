import pytest

from dwgs.scene import InputError
from generator.long_video import CLIP, STRIDE, anchors, padded, plan, seen, segments


def test_193_frames_are_49_anchors_and_four_segments_that_share_boundary_frames():
    assert anchors(193) == tuple(range(0, 193, 4))
    assert [(s[0], s[-1]) for s in segments(193)] == [(0, 48), (48, 96), (96, 144), (144, 192)]
    first, second = plan("global-to-local", 193)
    assert [p.frames for p in first] == [anchors(193)]
    assert [p.given for p in second] == [tuple(range(0, 49, 4))] * 4
    assert [i for p in second for i in p.makes] == list(range(193))


@pytest.mark.parametrize("strategy", ["global-to-local", "autoregressive", "single"])
@pytest.mark.parametrize("frames", [1, 2, 17, 48, 49, 50, 97, 192, 193, 194, 400, 769, 1000, 3073])
def test_every_frame_is_made_and_what_is_given_was_made_before(strategy, frames):
    made: set[int] = set()
    for level in plan(strategy, frames):
        for a_pass in level:
            assert {a_pass.frames[i] for i in a_pass.given} <= made
            assert len(a_pass.frames) % STRIDE == 1
            assert strategy == "single" or len(a_pass.frames) <= CLIP
        made |= {i for a_pass in level for i in a_pass.makes}
    assert set(range(frames)) <= made
    last = [i for a_pass in plan(strategy, frames)[-1] for i in a_pass.makes]
    assert len(set(last)) == len(last)


def test_capacity_grows_fourfold_with_each_level():
    assert [len(plan("global-to-local", n)) for n in (49, 50, 193, 194, 769, 770, 3073)] == [1, 2, 2, 3, 3, 4, 4]


def test_an_anchor_is_the_last_frame_of_each_latent_group():
    groups = [[0], *([4 * j - 3 + k for k in range(4)] for j in range(1, 13))]
    assert [g[-1] for g in groups] == list(plan("global-to-local", 193)[1][0].given)


def test_frames_past_the_end_repeat_the_last():
    assert padded(17, 4) == 17
    assert padded(18, 4) == 21
    assert seen(range(5), 3) == (0, 1, 2, 2, 2)


def test_impossible_videos_are_refused():
    with pytest.raises(InputError, match="at least one frame, got 0"):
        plan("single", 0)
    with pytest.raises(InputError, match="not 'sliding'"):
        plan("sliding", 100)  # pyright: ignore[reportArgumentType]
