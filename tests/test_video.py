"""Video that machines read back bit by bit, and video for people."""

from concurrent.futures import ThreadPoolExecutor

import av
import numpy as np
import pytest

from dwgs.scene import InputError
from dwgs.video import LosslessVideo, write_lossless, write_mp4


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).integers(0, 256, shape, np.uint8)


@pytest.mark.parametrize("fps", [10.0, 29.97, 59.94])
@pytest.mark.parametrize("shape", [(48, 72, 3), (49, 71, 3), (33, 35), (2, 3, 3), (1, 1)])
def test_every_bit_comes_back(tmp_path, shape, fps):
    frames = noise(7, *shape)
    write_lossless(tmp_path / "a.avi", iter(frames), fps)
    video = LosslessVideo(tmp_path / "a.avi")
    assert len(video) == 7
    assert (video.width, video.height) == (shape[1], shape[0])
    for i in range(7):
        np.testing.assert_array_equal(video[i], frames[i])


def test_frames_are_read_in_any_order_from_any_thread(tmp_path):
    frames = noise(20, 48, 64, 3)
    write_lossless(tmp_path / "a.avi", frames)
    video = LosslessVideo(tmp_path / "a.avi")
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(20), 3))
    with ThreadPoolExecutor(4) as pool:
        for i, frame in zip(order, pool.map(video.__getitem__, order), strict=True):
            np.testing.assert_array_equal(frame, frames[i])


def test_the_same_frames_make_the_same_file(tmp_path):
    for name in ("a.avi", "b.avi"):
        write_lossless(tmp_path / name, noise(3, 32, 32, 3))
    assert (tmp_path / "a.avi").read_bytes() == (tmp_path / "b.avi").read_bytes()


def test_a_flipped_byte_is_noticed(tmp_path):
    frames = noise(3, 48, 64, 3)
    write_lossless(tmp_path / "a.avi", frames)
    data = bytearray((tmp_path / "a.avi").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "a.avi").write_bytes(data)
    video = LosslessVideo(tmp_path / "a.avi")
    np.testing.assert_array_equal(video[0], frames[0])
    with pytest.raises(InputError, match=r"frame 1 of '.*a\.avi' is damaged"):
        video[1]


def test_a_video_cut_short_is_noticed(tmp_path):
    write_lossless(tmp_path / "a.avi", noise(5, 48, 64, 3))
    data = (tmp_path / "a.avi").read_bytes()
    (tmp_path / "a.avi").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="cut short"):
        LosslessVideo(tmp_path / "a.avi")


def test_what_is_no_lossless_video_is_refused(tmp_path):
    with pytest.raises(InputError, match="there is no video"):
        LosslessVideo(tmp_path / "a.avi")
    (tmp_path / "a.avi").write_bytes(b"no video")
    with pytest.raises(InputError, match="is not a video"):
        LosslessVideo(tmp_path / "a.avi")
    write_mp4(tmp_path / "a.mp4", noise(2, 32, 32, 3))
    with pytest.raises(InputError, match="h264 yuv420p, not lossless"):
        LosslessVideo(tmp_path / "a.mp4")


@pytest.mark.parametrize("write", [write_lossless, write_mp4])
def test_frames_are_alike_and_at_least_one_and_leave_nothing_half_written(tmp_path, write):
    with pytest.raises(InputError, match="at least one frame"):
        write(tmp_path / "a.avi", [])
    with pytest.raises(InputError, match=r"frame 1 is uint8 \(16, 18, 3\), not uint8 \(16, 16, 3\)"):
        write(tmp_path / "a.avi", [noise(16, 16, 3), noise(16, 18, 3)])
    assert not list(tmp_path.iterdir())


def test_people_see_the_colours_that_were_written_at_odd_sizes_too(tmp_path):
    colour = np.array([200, 60, 30], np.uint8)
    write_mp4(tmp_path / "a.mp4", np.broadcast_to(colour, (4, 31, 45, 3)), fps=24)
    with av.open(tmp_path / "a.mp4") as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert (stream.width, stream.height, stream.average_rate) == (46, 32, 24)
        assert frames[0].colorspace == 1  # the file says BT.709, so every player turns it back alike
        picture = frames[0].reformat(format="rgb24", src_colorspace="ITU709").to_ndarray()
    assert len(frames) == 4
    assert abs(picture.astype(int) - colour).max() <= 4
