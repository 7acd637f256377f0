import pytest
import torch
from diffusers import FirstBlockCacheConfig

from dwgs.scene import InputError
from generator.wan.denoise import Side, denoise
from generator.wan.settings import Sampling
from generator.wan.tiny import tiny_transformer

SHAPE = (1, 16, 3, 4, 6)


def latents(seed):
    return torch.randn(SHAPE, generator=torch.Generator().manual_seed(seed))


def side(value):
    return Side(torch.full((1, 1, *SHAPE[2:]), float(value)), torch.zeros(1, 2, 3))


class Flow:
    """A network whose velocity is what the test says, and which notes how it was called."""

    def __init__(self, velocity):
        self.velocity, self.batches, self.timesteps = velocity, [], []

    def __call__(self, hidden_states, timestep, control_hidden_states, **_):
        self.batches.append(len(hidden_states))
        self.timesteps.append(float(timestep[0]))
        return (self.velocity(hidden_states, timestep, control_hidden_states),)


@pytest.mark.parametrize("sampler", ["euler", "unipc"])
@pytest.mark.parametrize("guidance", [1.0, 2.5])
@pytest.mark.parametrize("steps", [1, 2, 7, 30, 50])
def test_the_exact_velocity_returns_the_data(sampler, guidance, steps):
    data, noise = latents(1), latents(2)
    flow = Flow(lambda x, *_: (noise - data).expand_as(x))  # Wan's sign: noise - data
    made = denoise(flow, noise, side(0), side(0), Sampling(sampler, steps, guidance=guidance))
    torch.testing.assert_close(made, data, atol=1e-6, rtol=0)
    assert flow.timesteps[0] == pytest.approx(1000, abs=1)


def test_the_timestep_is_a_thousand_sigma():
    data, noise = latents(1), latents(2)

    def velocity(x, timestep, _):
        sigma = timestep.view(-1, 1, 1, 1, 1) / 1000
        torch.testing.assert_close(x, (1 - sigma) * data + sigma * noise, atol=1e-2, rtol=0)
        return (noise - data).expand_as(x)

    denoise(Flow(velocity), noise, side(0), side(0), Sampling("euler", 10))


def test_guidance_weighs_what_the_condition_changes():
    flow = Flow(lambda x, _, control: control.mean((1, 2, 3, 4), keepdim=True).expand_as(x))
    noise = latents(1)
    one = denoise(flow, noise, side(3), side(1), Sampling("euler", 1, guidance=2.5))
    torch.testing.assert_close(one, noise - (1 + 2.5 * (3 - 1)))


def test_both_sides_agree_batched_and_in_turn_and_the_unguided_steps_cost_half():
    flow = Flow(lambda x, _, control: x * control.mean((1, 2, 3, 4), keepdim=True))
    batched, turns = (
        denoise(flow, latents(1), side(0.5), side(0.2), Sampling("euler", 4, guided=0.5, batched=batched))
        for batched in (True, False)
    )
    torch.testing.assert_close(batched, turns)
    assert flow.batches == [2, 2, 1, 1] + [1] * 6
    assert Sampling(steps=4, guided=0.5).evaluations == 6
    assert Sampling(steps=30, guidance=1).evaluations == 30


def test_a_cache_that_counts_hints_twice_is_refused():
    transformer = tiny_transformer()
    transformer.enable_cache(FirstBlockCacheConfig(threshold=0.5))
    with pytest.raises(InputError, match="FirstBlockCacheConfig counts the hints of a VACE branch twice"):
        denoise(transformer, latents(1), side(0), side(0), Sampling())


def test_that_cache_is_indeed_wrong():
    """When this fails, the library has mended it: allow the cache."""
    transformer = tiny_transformer()
    arguments = {
        "hidden_states": latents(1),
        "timestep": torch.tensor([500.0]),
        "encoder_hidden_states": torch.randn(1, 8, 16, generator=torch.Generator().manual_seed(3)),
        "control_hidden_states": torch.randn(1, 96, *SHAPE[2:], generator=torch.Generator().manual_seed(4)),
        "return_dict": False,
    }
    transformer.enable_cache(FirstBlockCacheConfig(threshold=0.5))
    with torch.no_grad(), transformer.cache_context("cond"):
        first, cached = (transformer(**arguments)[0] for _ in range(2))
    assert (first - cached).abs().max() > 0.01


def test_impossible_sampling_is_refused():
    with pytest.raises(InputError, match="at least one step"):
        Sampling(steps=0)
    with pytest.raises(InputError, match="guided share of 0 to 1"):
        Sampling(guided=1.5)
