"""What a run of the backends ``wan`` and ``vace`` is told: values only, so that a command starts without torch."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from dwgs.scene.errors import InputError
from generator.long_video import Strategy
from generator.wan.memory import Weights

Sampler = Literal["unipc", "euler"]
"""How the flow is integrated."""

Init = Literal["vace", "zero", "random"]
"""What an adapter starts as: the backbone's VACE branch, nothing at all, or noise. The paper does not say; ours is
``vace``."""

MaskTime = Literal["group", "vace"]
"""How masks of frames become masks of latent frames: ``group`` takes any of the (up to four) frames that a latent
frame encodes, ``vace`` picks one by nearest-exact resampling, as Wan2.1-VACE was trained, though the pick may lie in
a neighbour's group."""


@dataclass(frozen=True)
class Sampling:
    """How a clip is denoised. Steps and guidance are the paper's; it gives neither sampler nor shift."""

    sampler: Sampler = "unipc"
    """UniPC is what Wan2.1 is published with."""
    steps: int = 30
    """Evaluations of the flow."""
    shift: float = 3.0
    """Of the noise levels towards noise, as Wan2.1 is published for 480 rows."""
    guidance: float = 2.5
    """Weight of what the condition changes; 1 evaluates the condition alone."""
    guided: float = 1.0
    """Share of the steps, from the first on, that are guided; the others cost half."""
    batched: bool = True
    """Whether both sides of the guidance go through the network at once: faster, with more memory."""

    def __post_init__(self) -> None:
        if self.steps < 1 or not 0 <= self.guided <= 1 or self.shift <= 0:
            raise InputError(
                "sampling takes at least one step, a positive shift and a guided share of 0 to 1, got "
                f"{self.steps}, {self.shift} and {self.guided}"
            )

    @property
    def evaluations(self) -> int:
        """Forward passes of one clip."""
        return self.steps + (sum(map(self.is_guided, range(self.steps))))

    def is_guided(self, step: int) -> bool:
        """Whether a step, counted from 0, looks at both sides."""
        return self.guidance != 1 and step < self.guided * self.steps


@dataclass(frozen=True)
class Lora:
    """A borrowed change of the backbone's weights."""

    path: Path
    """Of a safetensors file."""
    strength: float = 1.0
    """Its weight; 0 is none of it."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.strength):
            raise InputError(f"a LoRA's strength is a number, '{self.path}' is given {self.strength}")

    @staticmethod
    def of(text: str) -> "Lora":
        """What ``FILE`` or ``FILE:STRENGTH`` says."""
        path, _, strength = text.rpartition(":")
        try:
            weight = float(strength)
        except ValueError:  # the colon, if any, is part of the name
            return Lora(Path(text))
        return Lora(Path(path), weight) if path else Lora(Path(text))


@dataclass(frozen=True)
class WanSettings:
    """What a run of the backend is told."""

    backbone: Path
    """Folder of Wan2.1-VACE in diffusers' layout."""
    adapter: Path | None = None
    """Folder of a PointAdapter; without one, VACE works as it is published, and sees no points."""
    strategy: Strategy = "global-to-local"
    """How a long video is made of runs of 49 frames."""
    sampling: Sampling = field(default_factory=Sampling)
    """How each is denoised."""
    devices: tuple[str, ...] = ()
    """Where; several share the clips of a level. By default the first GPU, else the CPU."""
    weights: Weights | None = None
    """What is done with the weights; by default what fits."""
    attention: str | None = None
    """One of diffusers' attention backends; by default PyTorch's."""
    whole_frame: bool = False
    """Whether whole images are painted, told of by LiDAR points of the whole street: StreetCrafter's way."""
    loras: tuple[Lora, ...] = ()
    """Added to the backbone's weights while it is loaded."""
    tiled: bool = False
    """Whether the autoencoder works in tiles: in less memory, with blended seams."""
