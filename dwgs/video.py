"""Video in and out: bit-exact for machines (MagicYUV), small for people (H.264)."""

import threading
import zlib
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from dwgs.files import new_file
from dwgs.scene.errors import InputError

MAX_PIXELS = 2**27
"""A video whose header claims larger frames [px] is refused before memory is asked for."""

_CHECKSUM = 4
"""Bytes behind a frame that decoders do not read."""
_BT709 = 1
_LIMITED_RANGE = 1


def write_lossless(path: Path, frames: Iterable[NDArray[np.uint8]], fps: float = 10.0) -> None:
    """Write uint8 frames, all [H, W, 3] RGB or all [H, W] grey, so that they read back bit by bit.

    MagicYUV in AVI, every frame on its own: any can be reached without its neighbours, in a sixth of FFV1's time and
    a third more bytes. A CRC-32 behind each frame tells a damaged one; every video tool opens the file all the same.
    """
    first, frames = _peek(frames)
    source, stored = ("gray", "gray") if first.ndim == 2 else ("rgb24", "gbrp")
    plain = {"fflags": "+bitexact"}  # the same frames make the same file
    with new_file(path) as draft, av.open(draft, "w", format="avi", options=plain) as container:
        stream = container.add_stream("magicyuv", rate=_rate(fps))
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = stored
        pictures = (
            VideoFrame.from_ndarray(frame, format=source).reformat(format=stored)
            for frame in _alike(frames, first.shape)
        )
        for picture in chain(pictures, [None]):
            container.mux([_signed(packet, stream) for packet in stream.encode(picture)])


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
        self._lock, self._decoders = threading.Lock(), threading.local()
        if not self.path.is_file():
            raise InputError(f"there is no video '{self.path}'; the folder is incomplete, write it again")
        try:
            self._container = av.open(self.path)
            self._stream = self._container.streams.video[0]
            self._stamps = [p.pts for p in self._container.demux(self._stream) if p.pts is not None]
        except (FFmpegError, IndexError) as error:
            raise InputError(f"'{self.path}' is not a video ({error}); write it again") from None
        codec = self._stream.codec_context
        if codec.name != "magicyuv" or codec.pix_fmt not in ("gbrp", "gray"):
            raise InputError(f"'{self.path}' is {codec.name} {codec.pix_fmt}, not lossless MagicYUV in gbrp or gray")
        if codec.width * codec.height > MAX_PIXELS:
            raise InputError(f"'{self.path}' claims frames of {codec.width}x{codec.height}, more than can be meant")
        self.width, self.height = codec.width, codec.height
        if len(self._stamps) != self._stream.frames:  # as the header says, set when the last one was written
            raise InputError(f"'{self.path}' is cut short after {len(self._stamps)} frames; write it again")

    def __len__(self) -> int:
        return len(self._stamps)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Frame ``index``: [H, W, 3] RGB or [H, W] grey."""
        stamp = self._stamps[index]
        try:
            with self._lock:
                self._container.seek(stamp, stream=self._stream)
                packet = next(p for p in self._container.demux(self._stream) if p.pts == stamp)
            if _is_whole(bytes(packet)):
                return np.asarray(self._decoder.decode(packet)[0].to_ndarray(), np.uint8)  # planes GBR to RGB
        except (FFmpegError, StopIteration, IndexError):
            pass
        raise InputError(f"frame {index} of '{self.path}' is damaged; write the video again")

    @property
    def _decoder(self) -> VideoCodecContext:
        """This thread's own: frames stand alone, so several are decoded at once."""
        if not hasattr(self._decoders, "own"):
            self._decoders.own = VideoCodecContext.create("magicyuv", "r")
            self._decoders.own.thread_count = 1
            self._decoders.own.options = {"max_pixels": str(MAX_PIXELS)}
        return self._decoders.own


def _signed(packet: av.Packet, stream: VideoStream) -> av.Packet:
    """A frame with its CRC-32 behind it."""
    data = bytes(packet)
    signed = av.Packet(data + zlib.crc32(data).to_bytes(_CHECKSUM, "little"))
    signed.stream, signed.time_base, signed.is_keyframe = stream, packet.time_base, True
    signed.pts, signed.dts, signed.duration = packet.pts, packet.dts, packet.duration
    return signed


def _is_whole(packet: bytes) -> bool:
    """Whether a frame bears out its checksum."""
    return zlib.crc32(packet[:-_CHECKSUM]) == int.from_bytes(packet[-_CHECKSUM:], "little")


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
