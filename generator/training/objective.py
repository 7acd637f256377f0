"""What a step asks of the network: the flow from a noisy clip to the recorded one, told of the vehicle's points."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from generator.training.cache import Sample
from generator.training.config import TrainingConfig
from generator.wan.denoise import TRAIN_STEPS
from generator.wan.settings import MaskTime


@dataclass(frozen=True)
class Draw:
    """What chance decides about one clip in one step."""

    sigma: float
    """Noise level, logit-normal."""
    aware: bool
    """Whether some frames are given."""
    dropped: bool
    """Whether it is shown no points."""
    noise: Tensor

    @staticmethod
    def of(sample: Sample, config: TrainingConfig, key: tuple[int, ...]) -> "Draw":
        """The draw of a key: the same in any process, and after any restart."""
        seed = int(np.random.SeedSequence([config.seed, *key]).generate_state(1, np.uint32)[0])
        random = torch.Generator().manual_seed(seed)
        normal = float(torch.randn((), generator=random))
        aware, dropped = (float(u) for u in torch.rand(2, generator=random))
        sigma = 1 / (1 + float(np.exp(-normal)))
        sigma = config.shift * sigma / (1 + (config.shift - 1) * sigma)
        is_aware = sample.stride == 1 and aware < config.aware
        noise = torch.randn(sample.target.shape, generator=random)
        return Draw(sigma, is_aware, dropped < config.dropout, noise)


@dataclass(frozen=True)
class Batch:
    """Clips with what was drawn for them, ready for the network."""

    noisy: Tensor
    """[B, z, T', h, w] (1 - sigma) data + sigma noise."""
    sigmas: Tensor
    """[B]."""
    control: Tensor
    """[B, 2 z + 128, T', h, w]."""
    flow: Tensor
    """[B, z, T', h, w] noise - data: what the network is to say."""

    @staticmethod
    def of(samples: Sequence[Sample], draws: Sequence[Draw], grey: Tensor, mask_time: MaskTime) -> "Batch":
        """Put together what was drawn; a clip without points is shown what guidance takes for its null."""
        controls = []
        for sample, draw in zip(samples, draws, strict=True):
            control = sample.control(draw.aware, mask_time)
            controls.append((control.without_points(grey) if draw.dropped else control).for_adapter())
        data = torch.cat([sample.target for sample in samples])
        noise = torch.cat([draw.noise for draw in draws])
        sigmas = torch.tensor([draw.sigma for draw in draws])
        mix = sigmas.view(-1, 1, 1, 1, 1)
        return Batch((1 - mix) * data + mix * noise, sigmas, torch.cat(controls), noise - data)


def loss_of(model: Any, batch: Batch, text: Tensor) -> Tensor:
    """Mean squared error of the flow, in float32."""
    device = text.device
    velocity = model(
        hidden_states=batch.noisy.to(device),
        timestep=TRAIN_STEPS * batch.sigmas.to(device),
        encoder_hidden_states=text.expand(len(batch.sigmas), -1, -1),
        control_hidden_states=batch.control.to(device),
        return_dict=False,
    )[0]
    return torch.nn.functional.mse_loss(velocity.float(), batch.flow.to(device))
