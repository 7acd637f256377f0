"""How a network of many billion parameters fits the memory there is: arithmetic, before anything is loaded."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from dwgs.scene.errors import InputError

Weights = Literal["resident", "streamed", "float8"]
"""Where weights live: all on the device; blocks fetched from host memory when their turn comes, same pictures; or on
the device with the backbone rounded to 8 bits, other pictures."""

GB = 1e9
CARDS = (24, 48, 80, 141)
"""What GPUs have [GB]."""
TILE = 256
"""Side of the autoencoder's tiles, where it works in tiles [px]; neighbours share a quarter, and are blended there."""
SPARE = 0.06
"""Share of a device's memory that is not ours: the driver's, the allocator's gaps."""


@dataclass(frozen=True)
class Footprint:
    """What denoising one clip needs."""

    backbone: int
    """Parameters that are frozen."""
    branch: int
    """Parameters of the adapter, or of VACE's own branch."""
    blocks: int
    """Blocks of the backbone."""
    activations: float
    """Of one side of the guidance [bytes]."""
    codec: float
    """Of decoding the clip, the autoencoder included [bytes]."""
    bytes_per_parameter: int
    """2 on a GPU, 4 on a CPU."""

    @staticmethod
    def of(
        config: Mapping[str, Any],
        backbone: int,
        branch: int,
        clip: tuple[int, int, int],
        bytes_per_parameter: int,
        tiled: bool = False,
    ) -> "Footprint":
        """Of a transformer's config, its parameters, and clips [T, H, W].

        Activations: the tokens' states, every hint, one feed-forward and a few copies in float32. The autoencoder
        works on four frames at a time, with some dozen maps of its first layer's width at full size, or of a tile's.
        """
        frames, height, width = clip
        tokens = (1 + (frames - 1) // 4) * (height // 16) * (width // 16)
        dim = config["num_attention_heads"] * config["attention_head_dim"]
        states = tokens * (2 * dim * (2 * len(config["vace_layers"]) + 6) + 4 * dim * 4 + 2 * 2 * config["ffn_dim"])
        if tiled:
            height, width = min(height, TILE), min(width, TILE)
        codec = 0.5 * GB + 4 * height * width * 96 * 2 * 16
        return Footprint(backbone, branch, config["num_layers"], states, codec, bytes_per_parameter)

    @property
    def weights(self) -> int:
        """Of all parameters, wherever they lie [bytes]."""
        return self.bytes_per_parameter * (self.backbone + self.branch)

    def needs(self, weights: Weights, batched: bool) -> float:
        """Device memory [bytes]."""
        if weights == "streamed":
            held = 2 * self.weights / self.blocks
        elif weights == "float8":
            held = self.backbone + self.bytes_per_parameter * self.branch
        else:
            held = self.weights
        return held + max(self.activations * (1 + batched), self.codec)


@dataclass(frozen=True)
class MemoryPlan:
    """What is done to fit."""

    weights: Weights
    batched: bool
    """Whether both sides of the guidance go through the network at once."""
    needs: float
    """Device memory [bytes]."""

    def __str__(self) -> str:
        sides = "both sides of the guidance at once" if self.batched else "the sides of the guidance in turn"
        return f"{self.needs / GB:.1f} GB: weights {self.weights}, {sides}"


def plan_memory(
    footprint: Footprint, capacity: float, choices: tuple[Weights, ...] = ("resident", "streamed")
) -> MemoryPlan:
    """The fastest way that fits, by default without changing the network's pictures.

    Args:
        footprint: What there is to fit.
        capacity: Of the device [bytes].
        choices: What may be done with the weights, best first.

    Raises:
        InputError: Nothing fits.
    """
    for choice in choices:
        for batched in (True, False):
            needs = footprint.needs(choice, batched)
            if needs <= (1 - SPARE) * capacity:
                return MemoryPlan(choice, batched, needs)
    least = min(footprint.needs(choice, False) for choice in choices)
    raise InputError(
        f"such clips take at least {least / GB:.1f} GB on the device, it has {capacity / GB:.1f} GB; make the images "
        "smaller with --size, or take --backend composite, which needs no GPU"
    )


def table(footprint: Footprint) -> list[str]:
    """One line for each usual size of GPU."""
    lines = []
    for card in CARDS:
        try:
            lines.append(f"{card:>4} GB  {plan_memory(footprint, card * GB)}")
        except InputError:
            lines.append(f"{card:>4} GB  too small")
    return lines
