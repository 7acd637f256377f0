"""How an adapter is trained: values only."""

from dataclasses import dataclass
from typing import Literal

from dwgs.scene.errors import InputError
from generator.long_video import CLIP, STRIDE, Strategy, plan
from generator.wan.settings import Init, MaskTime


@dataclass(frozen=True)
class ClipConfig:
    """Which parts of a drive teach."""

    frames: int = CLIP
    """Of one clip, 1 + 4 k."""
    strides: tuple[int, ...] = (1, STRIDE)
    """Frames from one to the next: 1 as in a segment, 4 as between anchors."""
    hop: int = 24
    """A vehicle's clips begin so many steps of the clip apart."""
    strategy: Strategy = "global-to-local"
    """What GT-aware clips are given: every fourth frame, or (autoregressive) the first."""
    points: Literal["discs", "pixels"] = "discs"
    """How points are drawn; ``pixels`` is the paper's ablation."""
    whole_frame: bool = False
    """Whether whole images are painted, told of by LiDAR points of the whole street: StreetCrafter's way."""
    seed: int = 0
    """Of how given frames are degraded."""

    def __post_init__(self) -> None:
        if self.frames < 5 or self.frames % STRIDE != 1 or self.hop < 1 or min(self.strides, default=0) < 1:
            raise InputError(
                "a training clip has 1 + 4 k frames, at least 5, with strides and a hop of at least 1, got "
                f"{self.frames}, {self.strides} and {self.hop}"
            )
        if self.whole_frame and self.points != "discs":
            raise InputError("whole frames are drawn with discs; leave --points or --whole-frame out")

    @property
    def given(self) -> tuple[int, ...]:
        """Positions in a GT-aware clip whose pixels are given."""
        return tuple(at for at in plan(self.strategy, 2 * CLIP)[-1][-1].given if at < self.frames)


@dataclass(frozen=True)
class TrainingConfig:
    """The paper's numbers where it states them; the others say so."""

    steps: int = 20_000
    """Steps of the optimiser."""
    batch: int = 8
    """Clips per step, over all processes."""
    at_once: int = 1
    """Of these, so many go through the network together in each process: more take more memory."""
    rate: float = 1e-5
    """Learning rate of Adam."""
    warmup: int = 100
    """Steps until the rate is reached."""
    dropout: float = 0.15
    """Share of clips that are shown no points, so that guidance has its null."""
    aware: float = 0.5
    """Share of stride-1 clips that are GT-aware; not in the paper."""
    shift: float = 1.0
    """Of the noise levels towards noise; the paper says logit-normal, and no shift."""
    ema: float = 0.999
    """Decay of the average that is kept of the weights; not in the paper."""
    init: Init = "vace"
    """What the adapter starts as; not in the paper."""
    mask_time: MaskTime = "group"
    """How masks of frames become masks of latent frames; not in the paper."""
    trains: Literal["adapter", "all"] = "adapter"
    """``all`` is the paper's ablation: the backbone learns, too."""
    precision: Literal["bf16", "no"] = "bf16"
    """Of the arithmetic; the adapter's own weights are float32."""
    checkpoint_every: int = 500
    """Steps between checkpoints, and between looks at the held-out clips."""
    keep: int = 2
    """So many checkpoints are kept, the newest."""
    seed: int = 0
    """Of everything random."""

    def __post_init__(self) -> None:
        if min(self.steps, self.batch, self.at_once, self.checkpoint_every, self.keep) < 1 or self.warmup < 0:
            raise InputError("steps, batch, at-once, checkpoint-every and keep are at least 1, warmup at least 0")
        if not (0 <= self.dropout <= 1 and 0 <= self.aware <= 1 and 0 <= self.ema < 1):
            raise InputError("dropout and aware are shares of 0 to 1, ema is at least 0 and less than 1")

    def rate_at(self, step: int) -> float:
        """Learning rate of a step, counted from 0: a linear warm-up, then constant."""
        return self.rate * min(1.0, (step + 1) / max(self.warmup, 1))


PRESETS = {
    "paper": (ClipConfig(), TrainingConfig()),
    "tiny": (
        ClipConfig(frames=9, hop=4),
        TrainingConfig(300, 4, 4, 1e-3, 10, ema=0.9, precision="no", checkpoint_every=50),
    ),
}
"""``paper`` for Wan2.1 on GPUs; ``tiny`` runs the same lines on a CPU in minutes, on a backbone of toy size."""
