"""What can be said of one edited drive without any network."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dwgs.metrics import psnr, ssim
from dwgs.metrics.skin import flicker, point_error, skin_colors
from dwgs.scene import Insertion, Scene


@dataclass(frozen=True)
class Subject:
    """A drive into which every system puts the same vehicle, and what their results are held against."""

    recorded: Scene
    """As it was."""
    insertion: Insertion
    """What is put where."""
    reactive_masks: tuple[Callable[[], NDArray[np.bool_]], ...] = field(repr=False)
    """Where systems may paint [H, W], for each frame of the main camera."""
    truth: Scene | None = None
    """The drive with the true vehicle, where that is known; its frames carry the masks of what it changes."""


def measure(subject: Subject, edited: Scene, on_progress: Callable[[int, int], None] | None = None) -> dict[str, float]:
    """Measures of an edited drive's main camera, by the keys of `COLUMNS`; what does not apply is left out.

    Means over frames. PSNR and SSIM against the truth count where the vehicle may be painted or truly shows, so
    that the pixels are the same for every system.
    """
    name = subject.recorded.main_camera
    frames, recorded = edited.frames[name], subject.recorded.frames[name]
    truths = subject.truth.frames[name] if subject.truth else ()
    kept = outside = 0
    scores: list[tuple[float, float]] = []
    for i, (after, before, load_mask) in enumerate(zip(frames, recorded, subject.reactive_masks, strict=True)):
        mask, pixels = load_mask(), after.pixels
        kept += int((pixels == before.pixels).all(-1)[~mask].sum())
        outside += int((~mask).sum())
        if truths:
            shown = truths[i].reactive_mask
            compared = mask if shown is None else mask | shown
            if compared.any():
                image, truth = (x / np.float32(255) for x in (pixels, truths[i].pixels))
                scores.append((psnr(image, truth, compared), ssim(image, truth, compared)))
        if on_progress:
            on_progress(i + 1, len(frames))
    colors, own = skin_colors(subject.insertion, [f.camera for f in frames], lambda t: frames[t].pixels)
    values = {"kept": 100 * kept / max(outside, 1), "point_error": point_error(colors, own), "flicker": flicker(colors)}
    if scores:
        values["oracle_psnr"], values["oracle_ssim"] = (float(np.mean(column)) for column in zip(*scores, strict=True))
    return {key: value for key, value in values.items() if not math.isnan(value)}
