"""Which frames each run of a network makes, and which it is given: integers only."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from dwgs.scene.errors import InputError

CLIP = 49
"""Frames of one run: what the networks were trained on."""
STRIDE = 4
"""Frames between anchors, and of one latent frame of the video codec."""

Strategy = Literal["global-to-local", "autoregressive", "single"]
"""How a long video is made of runs."""


@dataclass(frozen=True)
class Pass:
    """One run of a network."""

    frames: tuple[int, ...]
    """Indices of the frames it sees; one past the end of the video stands for a repeated last frame."""
    given: tuple[int, ...] = ()
    """Positions in ``frames`` whose pixels an earlier level has made."""
    drops: int = 0
    """So many frames at its start are left to the pass before, which made them, too."""

    @property
    def makes(self) -> tuple[int, ...]:
        """Indices of the frames whose pixels it gives."""
        return self.frames[self.drops :]


Level = tuple[Pass, ...]
"""Passes that know nothing of each other: they may run in any order, or at once."""


def plan(strategy: Strategy, frames: int) -> tuple[Level, ...]:
    """Levels of passes, in order, for a video of so many frames; later levels overwrite what earlier ones made.

    Raises:
        InputError: There is no frame, or no such strategy.
    """
    if frames < 1:
        raise InputError(f"a video has at least one frame, got {frames}")
    if strategy == "single" or (frames <= CLIP and strategy in ("global-to-local", "autoregressive")):
        return ((Pass(tuple(range(padded(frames, STRIDE)))),),)
    if strategy == "global-to-local":
        return _global_to_local(frames)
    if strategy == "autoregressive":
        return _autoregressive(frames)
    raise InputError(f"a long video is made global-to-local, autoregressive or single, not '{strategy}'")


def padded(frames: int, step: int) -> int:
    """The least 1 + k step that holds so many frames: the last frame is repeated, the surplus cut afterwards."""
    return 1 + -(-(frames - 1) // step) * step


def anchors(frames: int) -> tuple[int, ...]:
    """Every fourth frame, the first and the (padded) last included: 0, 4, ..., 192 of 193."""
    return tuple(range(0, padded(frames, CLIP - 1), STRIDE))


def segments(frames: int) -> tuple[range, ...]:
    """Clips of 49 frames, neighbours sharing a boundary frame: 193 = 1 + 48 * 4 frames are four of them."""
    step = CLIP - 1
    return tuple(range(start, start + CLIP) for start in range(0, padded(frames, step) - 1, step))


def _global_to_local(frames: int) -> tuple[Level, ...]:
    """The anchors as a video of their own, by recursion; then the segments between them, each on its own."""
    coarse = anchors(frames)
    above = plan("global-to-local", len(coarse))
    scaled = tuple(tuple(_spread(a_pass) for a_pass in level) for level in above)
    local = tuple(
        Pass(tuple(segment), tuple(range(0, CLIP, STRIDE)), drops=int(number > 0))
        for number, segment in enumerate(segments(frames))
    )
    return (*scaled, local)


def _spread(a_pass: Pass) -> Pass:
    """A pass over anchor numbers as one over the frames they stand for."""
    return Pass(tuple(STRIDE * i for i in a_pass.frames), a_pass.given, a_pass.drops)


def _autoregressive(frames: int) -> tuple[Level, ...]:
    """Each segment after the one before, whose last frame it is given."""
    return tuple(
        (Pass(tuple(segment), (0,) if number else (), drops=int(number > 0)),)
        for number, segment in enumerate(segments(frames))
    )


def seen(frames: Sequence[int], count: int) -> tuple[int, ...]:
    """Indices of recorded frames that a pass over ``frames`` sees: past the end, the last one again."""
    return tuple(min(i, count - 1) for i in frames)
