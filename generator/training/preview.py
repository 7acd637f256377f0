"""Held-out clips as the network would paint them now: what a curve of losses does not show."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from generator.training.cache import Cache, Sample, vehicle_of
from generator.training.loop import Trainer
from generator.wan.denoise import Side, denoise
from generator.wan.encode import Codec
from generator.wan.settings import Sampling

CLIPS = 2
"""So many are painted: those that show a vehicle largest, each another one."""
SAMPLING = Sampling(steps=10)
"""As in generating, in a third of the steps: it is done again and again."""


@dataclass(frozen=True)
class Preview:
    """A held-out clip, painted by the averaged network from its points alone."""

    sample: Sample
    painted: Tensor
    """Latents [1, z, T', h, w]."""

    def film(self, codec: Codec) -> NDArray[np.uint8]:
        """Images [T, H, 3 W, 3]: the recording, the points the network was told, and what it painted there."""
        recorded, points, painted = (
            codec.decode(latents) for latents in (self.sample.target, self.sample.points, self.painted)
        )
        region = self.sample.reactive_mask[..., None]
        return np.concatenate([recorded, points, np.where(region, painted, recorded)], 2)


def preview(trainer: Trainer) -> list[Preview]:
    """Paint some held-out clips, from the same noise every time; training goes on as if it had not been done.

    All processes of a training must call.
    """
    with trainer.averaged(), trainer.arithmetic():
        return [_painted(trainer, number) for number in _chosen(trainer.cache, trainer.held_out)]


def _chosen(cache: Cache, held_out: list[int]) -> list[int]:
    largest: dict[str, int] = {}
    for number in sorted(held_out, key=lambda number: -np.count_nonzero(cache[number].reactive_mask)):
        largest.setdefault(vehicle_of(cache.names[number]), number)
    return list(largest.values())[:CLIPS]


def _painted(trainer: Trainer, number: int) -> Preview:
    sample, device = trainer.cache[number], trainer.text.device
    control = sample.control(aware=False, mask_time=trainer.config.mask_time)
    told, blind = (Side(c.for_adapter(), trainer.text) for c in (control, control.without_points(trainer.grey)))
    noise = torch.randn(sample.target.shape, generator=torch.Generator().manual_seed(number))
    return Preview(sample, denoise(trainer.transformer, noise.to(device), told, blind, SAMPLING))
