"""Paints a clip whose frames need nothing of each other, several at a time."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

from dwgs.scene.scene import Frame, Scene
from generator.conditions.conditions import ConditionFrame, Conditions

THREADS = 2
"""Frames painted at once."""


def frame_by_frame(
    conditions: Conditions,
    paint: Callable[[int, ConditionFrame], Frame],
    on_progress: Callable[[int, int], None] | None = None,
) -> Scene:
    """The recorded scene with every frame painted.

    Args:
        conditions: What to draw where.
        paint: Of (number of the camera, frame's condition), thread-safe: the painted frame.
        on_progress: Called with (frames done, frames in all).
    """
    total = sum(len(frames) for frames in conditions.frames.values())
    edited: dict[str, tuple[Frame, ...]] = {}
    done = 0
    with ThreadPoolExecutor(THREADS) as pool:
        for number, (name, frames) in enumerate(conditions.frames.items()):
            painted = []
            for frame in pool.map(partial(paint, number), frames):
                painted.append(frame)
                done += 1
                if on_progress:
                    on_progress(done, total)
            edited[name] = tuple(painted)
    return replace(conditions.scene, frames=edited)
