"""What a training takes on each GPU: arithmetic, before anything is loaded."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from generator.training.config import TrainingConfig
from generator.wan.memory import GB

_LEARNT = 4 * 5
"""Bytes of a parameter that learns: itself, its gradient, two moments and its average, in float32."""
_GATHERED = 2
"""Blocks whose parts are brought together at once, with their gradients if they learn: one works, one is fetched."""


@dataclass(frozen=True)
class TrainingFootprint:
    """Memory of one process [bytes]."""

    frozen: float
    """Weights that do not learn."""
    learnt: float
    """Weights that do, with gradients, moments and average."""
    gathered: float
    """Whole blocks, where the network is shared out."""
    activations: float
    """What checkpointing keeps of every block, and one block in full."""

    @staticmethod
    def of(
        backbone: Mapping[str, Any],
        parameters: tuple[int, int],
        clip: tuple[int, ...],
        config: TrainingConfig,
        processes: int,
        sharded: bool,
    ) -> "TrainingFootprint":
        """Of a backbone's config, the parameters of (backbone, adapter), and clips [T, H, W].

        A block in full: a dozen states in 16 bits and half as many in float32, and the feed-forward three times.
        """
        whole, adapter = parameters
        width, blocks = backbone["num_attention_heads"] * backbone["attention_head_dim"], backbone["num_layers"]
        hints = len(backbone["vace_layers"])
        half = 2 if config.precision == "bf16" else 4
        learns = whole + adapter if config.trains == "all" else adapter
        frozen, learnt = half * (whole + adapter - learns), _LEARNT * learns
        frames, height, columns = clip
        tokens = (1 + (frames - 1) // 4) * (height // 16) * (columns // 16)
        kept = (blocks + hints) * width * half
        one = 12 * width * half + 6 * width * 4 + 3 * backbone["ffn_dim"] * half
        together = min(config.at_once, config.batch // processes)
        block = max(8 * adapter / hints, (8 if config.trains == "all" else half) * whole / blocks)
        parts, gathered = (processes, _GATHERED * block) if sharded else (1, 0.0)
        return TrainingFootprint(frozen / parts, learnt / parts, gathered, together * tokens * (kept + one))

    @property
    def total(self) -> float:
        """All of it [bytes]."""
        return self.frozen + self.learnt + self.gathered + self.activations

    def __str__(self) -> str:
        named = {
            "frozen weights": self.frozen,
            "learning weights with their gradients, moments and average": self.learnt,
            "blocks brought together": self.gathered,
            "activations": self.activations,
        }
        parts = ", ".join(f"{size / GB:.1f} {name}" for name, size in named.items() if size)
        return f"{self.total / GB:.1f} GB: {parts}"
