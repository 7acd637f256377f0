"""What an evaluation measures of a system."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dwgs.metrics.frechet import frechet_distance
from dwgs.metrics.network import CLIP_FRAMES, CLIP_STRIDE

FRECHET_SAMPLES = 200
"""Resamplings behind the interval of a Frechet distance: each costs a singular value decomposition."""

SIGNS = {"high": "↑", "low": "↓", "truth": "≈"}
"""Which way is better."""


@dataclass(frozen=True)
class Measured:
    """What was measured of a system on one sequence."""

    values: dict[str, float]
    """By the key of a column."""
    features: dict[str, tuple[NDArray[np.float32], NDArray[np.float32]]] = field(default_factory=dict, repr=False)
    """By the key of a column: features [N, D] of the edited video and [M, D] of the recorded one."""


@dataclass(frozen=True)
class Column:
    """One measure."""

    key: str
    """For programs."""
    title: str
    """For people."""
    meaning: str
    """In one line."""
    better: Literal["high", "low", "truth"]
    """Which way; ``truth`` is near what the true vehicle has: light changes colours, and pixels mix them."""
    digits: int
    """After the point."""
    is_frechet: bool = False
    """A distance of all sequences' features together; otherwise the mean of the sequences' own values."""
    weights: str | None = None
    """Option that names the network it needs, if it needs one."""

    @property
    def heading(self) -> str:
        """Title and direction."""
        return f"{self.title} {SIGNS[self.better]}"

    def has(self, measured: Measured) -> bool:
        """Whether a sequence counts: of one feature alone no spread is known."""
        if self.is_frechet:
            return all(len(f) >= 2 for f in measured.features.get(self.key, ((),)))
        return self.key in measured.values

    def pool(self, sequences: Sequence[Measured]) -> float:
        """The measure over sequences that all count."""
        if not self.is_frechet:
            return float(np.mean([m.values[self.key] for m in sequences]))
        edited, recorded = (np.concatenate([m.features[self.key][k] for m in sequences]) for k in (0, 1))
        return frechet_distance(edited, recorded)


COLUMNS = (
    Column("fid", "FID", "Frechet distance of image features, edited from recorded", "low", 2, True, "--fid"),
    Column("fvd", "FVD", f"the same of clips of {CLIP_FRAMES} frames, {CLIP_STRIDE} apart", "low", 2, True, "--fvd"),
    Column("lpips", "LPIPS", "perceptual distance of edited from recorded frames", "low", 3, weights="--lpips"),
    Column("joint_psnr", "recon PSNR", "[dB] of a joint reconstruction of the edited video", "high", 2),
    Column("joint_ssim", "recon SSIM", "of the same", "high", 3),
    Column("oracle_psnr", "PSNR", "[dB] from the true vehicle, where it may be painted or shows", "high", 2),
    Column("oracle_ssim", "SSIM", "of the same", "high", 3),
    Column("kept", "kept", "[%] of the recorded pixels outside the reactive masks, bit for bit", "high", 2),
    Column("point_error", "points", "[levels] error of telling the points' colours from the video", "truth", 1),
    Column("flicker", "flicker", "[levels] a point of the vehicle off its mean before and after", "truth", 2),
    Column("distill_psnr", "distilled", "[dB] held-out ROI PSNR of the distillation: how much it is one", "high", 2),
)
"""All of them. The first five are the paper's; the others need no weights. Levels are of 255."""
PAPER = 5
"""So many are the paper's."""
