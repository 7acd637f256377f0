"""From noise to a video's latents: flow matching as Wan was trained, guided by the points.

Wan predicts noise - data at timestep 1000 sigma, with x = (1 - sigma) data + sigma noise. The paper writes the same
flow the other way round: its t is 1 - sigma, its velocity has the other sign.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from diffusers import FlowMatchEulerDiscreteScheduler, UniPCMultistepScheduler
from torch import Tensor

from dwgs.scene.errors import InputError
from generator.wan.settings import Sampling

TRAIN_STEPS = 1000
"""Wan's timestep at sigma = 1."""


@dataclass(frozen=True)
class Side:
    """What the network is told on one side of the guidance."""

    control: Tensor
    """[1, C, T', h, w] condition channels."""
    text: Tensor
    """[1, L, D] embedding."""


@torch.no_grad()
def denoise(
    model: Callable[..., Any],
    noise: Tensor,
    condition: Side,
    null: Side,
    sampling: Sampling,
    on_step: Callable[[int], None] | None = None,
) -> Tensor:
    """Latents [1, z, T', h, w] float32 that follow the flow from ``noise``.

    v = v_null + guidance (v_condition - v_null), the null being the same condition without what guides.

    Args:
        model: A Wan transformer, or what is called like one.
        noise: Standard normal, of the latents' shape.
        condition: What is wanted.
        null: The other side.
        sampling: Steps and guidance.
        on_step: Called with the number of steps done.
    """
    require_sound_cache(model)
    scheduler = scheduler_of(sampling)
    x = noise.double()  # latents are small, and UniPC takes differences of differences
    for step, timestep in enumerate(scheduler.timesteps):
        if not sampling.is_guided(step):
            velocity = _velocity(model, x, timestep, [condition])[0]
        else:
            sides = [condition, null]
            both = (
                _velocity(model, x, timestep, sides)
                if sampling.batched
                else [_velocity(model, x, timestep, [side])[0] for side in sides]
            )
            velocity = both[1] + sampling.guidance * (both[0] - both[1])
        if step == 0:  # UniPC begins a little below sigma = 1, where log(1 - sigma) would be infinite: go there
            x = x + (scheduler.sigmas[0].item() - 1) * velocity
        x = scheduler.step(velocity, timestep, x, return_dict=False)[0]
        if on_step:
            on_step(step + 1)
    return x.float()


def scheduler_of(sampling: Sampling) -> Any:
    """The integrator, from noise to data."""
    if sampling.sampler == "euler":
        scheduler = FlowMatchEulerDiscreteScheduler(num_train_timesteps=TRAIN_STEPS, shift=sampling.shift)
    else:
        scheduler = UniPCMultistepScheduler(
            num_train_timesteps=TRAIN_STEPS,
            prediction_type="flow_prediction",
            use_flow_sigmas=True,
            flow_shift=sampling.shift,
        )
    scheduler.set_timesteps(sampling.steps)
    return scheduler


def _velocity(model: Callable[..., Any], x: Tensor, timestep: Tensor, sides: list[Side]) -> list[Tensor]:
    """noise - data [1, z, T', h, w] float64 as the network sees it, for each side."""
    dtype = getattr(model, "dtype", torch.float32)
    velocity = model(
        hidden_states=x.to(dtype).expand(len(sides), -1, -1, -1, -1),
        timestep=timestep.to(x.device).expand(len(sides)),
        encoder_hidden_states=torch.cat([side.text for side in sides]).to(x.device, dtype),
        control_hidden_states=torch.cat([side.control for side in sides]).to(x.device, dtype),
        return_dict=False,
    )[0]
    return list(velocity.double().split(1))


def require_sound_cache(model: Any) -> None:
    """Raise `InputError` where a cache is switched on that gives wrong pictures on this architecture.

    Caches of the first block's residual keep what the hints added, and the model adds them again.
    """
    config = getattr(model, "_cache_config", None)
    if type(config).__name__ in ("FirstBlockCacheConfig", "MagCacheConfig"):
        raise InputError(
            f"{type(config).__name__} counts the hints of a VACE branch twice and gives wrong pictures; "
            "switch it off with transformer.disable_cache(), and guide only part of the steps instead"
        )
