"""Video in and out: bit-exact for machines (FFV1), small for people (H.264)."""

import threading
import zlib
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError
from av.video.frame import VideoFrame
from numpy.typing import NDArray

from dwgs.files import new_file
from dwgs.scene.errors import InputError

MAX_PIXELS = 2**27
"""A video whose header claims larger frames [px] is refused before memory is asked for."""

THREADS = 2
"""Work on the slices of one lossless frame; the bytes do not depend on it."""

_TURNED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_BT709 = 1
_LIMITED_RANGE = 1


def write_lossless(path: Path, frames: Iterable[NDArray[np.uint8]], fps: float = 10.0) -> None:
    """Write uint8 frames, all [H, W, 3] RGB or all [H, W] grey, so that they read back bit by bit.

    FFV1 level 3 in Matroska, every frame on its own: any can be reached without its neighbours, a damaged one
    is noticed by its checksum, and every video tool opens the file.
    """
    options = {"level": "3", "slicecrc": "1", "g": "1"}
    first, frames = _peek(frames)
    source, stored = ("gray", "gray") if first.ndim == 2 else ("rgb24", "bgr0")
    plain = {"fflags": "+bitexact"}  # no random identity: the same frames make the same file
    with new_file(path) as draft, av.open(draft, "w", format="matroska", options=plain) as container:
        stream = container.add_stream("ffv1", rate=_rate(fps), options=options)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = stored
        stream.codec_context.thread_type, stream.codec_context.thread_count = "SLICE", THREADS
        for frame in _alike(frames, first.shape):
            container.mux(stream.encode(VideoFrame.from_ndarray(frame, format=source).reformat(format=stored)))
        container.mux(stream.encode())


def write_mp4(path: Path, frames: Iterable[NDArray[np.uint8]], fps: float = 10.0) -> None:
    """Write uint8 frames [H, W, 3] for people to watch: H.264, visually clean, played by every browser.

    Chroma is stored at half resolution, which needs even sizes: an odd last row or column is repeated once.
    """
    options = {"crf": "16", "preset": "veryfast"}
    first, frames = _peek(frames)
    height, width = first.shape[:2]
    with (
        new_file(path) as draft,
        av.open(draft, "w", format="mp4", options={"movflags": "+faststart"}) as container,
    ):
        stream = container.add_stream("libx264", rate=_rate(fps), options=options)
        stream.height, stream.width = height + height % 2, width + width % 2
        stream.pix_fmt = "yuv420p"
        codec = stream.codec_context
        codec.color_primaries = codec.color_trc = codec.colorspace = _BT709
        codec.color_range = _LIMITED_RANGE
        for frame in _alike(frames, first.shape):
            even = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            picture = VideoFrame.from_ndarray(even, format="rgb24")
            container.mux(stream.encode(picture.reformat(format="yuv420p", dst_colorspace="ITU709")))
        container.mux(stream.encode())


class LosslessVideo:
    """Frames of a file of `write_lossless`, read one by one in any order, from any thread.

    Raises `InputError` where the file is missing, no such video, cut short or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._lock = threading.Lock()
        if not self.path.is_file():
            raise InputError(f"there is no video '{self.path}'; the folder is incomplete, write it again")
        try:
            self._container = av.open(self.path)
            self._stream = self._container.streams.video[0]
            self._stamps = [p.pts for p in self._container.demux(self._stream) if p.pts is not None]
        except (FFmpegError, IndexError) as error:
            raise InputError(f"'{self.path}' is not a video ({error}); write it again") from None
        codec = self._stream.codec_context
        codec.thread_type, codec.thread_count = "SLICE", THREADS
        if codec.name != "ffv1" or codec.pix_fmt not in ("bgr0", "gray"):
            raise InputError(f"'{self.path}' is {codec.name} {codec.pix_fmt}, not lossless FFV1 in bgr0 or gray")
        if codec.width * codec.height > MAX_PIXELS:
            raise InputError(f"'{self.path}' claims frames of {codec.width}x{codec.height}, more than can be meant")
        self.width, self.height = codec.width, codec.height
        self._format = "gray" if codec.pix_fmt == "gray" else "rgb24"
        stated = self._container.duration  # microseconds, set when the last frame was written
        rate = self._stream.average_rate
        if not stated or not rate or len(self._stamps) != round(stated * 1e-6 * rate):
            raise InputError(f"'{self.path}' is cut short after {len(self._stamps)} frames; write it again")

    def __len__(self) -> int:
        return len(self._stamps)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Frame ``index``: [H, W, 3] RGB or [H, W] grey."""
        stamp = self._stamps[index]
        with self._lock:
            try:
                self._container.seek(stamp, stream=self._stream)
                packet = next(p for p in self._container.demux(self._stream) if p.pts == stamp)
                if _is_whole(bytes(packet)):
                    return np.asarray(packet.decode()[0].to_ndarray(format=self._format), np.uint8)
            except (FFmpegError, StopIteration, IndexError):
                pass
        raise InputError(f"frame {index} of '{self.path}' is damaged; write the video again")


def _is_whole(packet: bytes) -> bool:
    """Whether every slice of an FFV1 frame bears out its checksum, which the decoder reads but does not heed.

    A slice ends with its size (3 bytes), a status (1) and a CRC-32 (4) that makes the remainder 0 (RFC 9043).
    The CRC takes the highest bit first, zlib's the lowest: turning every byte around reconciles them.
    """
    end = len(packet)
    while end > 0:
        start = end - 8 - int.from_bytes(packet[end - 8 : end - 5], "big")
        if start < 0 or zlib.crc32(packet[start:end].translate(_TURNED), 0xFFFFFFFF) != 0xFFFFFFFF:
            return False
        end = start
    return end == 0 and len(packet) > 0


def _peek(frames: Iterable[NDArray[np.uint8]]) -> tuple[NDArray[np.uint8], Iterator[NDArray[np.uint8]]]:
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise InputError("a video has at least one frame, this one has none")
    return first, chain([first], frames)


def _alike(frames: Iterable[NDArray[np.uint8]], shape: tuple[int, ...]) -> Iterator[NDArray[np.uint8]]:
    for i, frame in enumerate(frames):
        if frame.shape != shape or frame.dtype != np.uint8:
            raise InputError(
                f"frames of a video are alike: frame {i} is {frame.dtype} {frame.shape}, not uint8 {shape}"
            )
        yield np.ascontiguousarray(frame)


def _rate(fps: float) -> Fraction:
    return Fraction(fps).limit_denominator(1001)
