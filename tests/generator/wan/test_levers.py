"""What makes generating faster, or fit: each does what it says, and is refused where it cannot."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from dwgs.scene import InputError
from generator.wan.encode import Codec
from generator.wan.memory import GB, Footprint, MemoryPlan
from generator.wan.network import place, require_attention
from generator.wan.settings import Sampling, WanSettings
from generator.wan.tiny import TEXT_DIM, tiny_transformer, tiny_vae
from generator.wan.wan import WanGenerator


def velocity(weights="resident", attention=None):
    """What the toy says when it is placed so."""
    transformer = tiny_transformer()
    place(transformer, "cpu", MemoryPlan(weights, True, 0), attention)
    random = torch.Generator().manual_seed(1)
    with torch.no_grad():
        return transformer(
            hidden_states=torch.randn(1, 16, 3, 4, 6, generator=random),
            timestep=torch.tensor([500.0]),
            encoder_hidden_states=torch.randn(1, 8, TEXT_DIM, generator=random),
            control_hidden_states=torch.randn(1, 96, 3, 4, 6, generator=random),
            return_dict=False,
        )[0]


@pytest.fixture(scope="module")
def resident():
    return velocity()


def test_blocks_that_are_fetched_when_their_turn_comes_say_the_same(resident):
    assert torch.equal(velocity("streamed"), resident)


def test_weights_of_8_bits_take_a_quarter_of_32_and_say_nearly_the_same(resident):
    transformer = tiny_transformer()
    place(transformer, "cpu", MemoryPlan("float8", True, 0), None)
    assert transformer.blocks[0].ffn.net[2].weight.dtype == torch.float8_e4m3fn
    assert transformer.vace_blocks[0].ffn.net[2].weight.dtype == torch.float32  # what was learnt is not rounded
    error = (velocity("float8") - resident).abs().mean() / resident.abs().mean()
    assert 0 < error < 0.1


def test_another_attention_says_the_same(resident):
    try:
        torch.testing.assert_close(velocity(attention="_native_math"), resident)
    finally:
        tiny_transformer().set_attention_backend("native")  # it is one for the whole process


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nonsense", "attention 'nonsense' does not work on cpu .*; leave --attention out"),
        ("flash", "attention 'flash' does not work on cpu .*install `flash-attn"),
        ("_native_cudnn", "attention '_native_cudnn' does not work on cpu"),
    ],
)
def test_an_attention_that_is_not_there_is_refused_before_anything_is_loaded(name, said, backbone_folder):
    with pytest.raises(InputError, match=said):
        WanGenerator(WanSettings(backbone_folder, attention=name, devices=("cpu",)))


def test_one_that_is_there_is_let_pass():
    require_attention("native", "cpu")


def test_tiles_change_seams_only():
    images = np.random.default_rng(0).integers(0, 256, (5, 17, 2, 3), np.uint8).repeat(16, 1).repeat(16, 2)
    whole, tiled = Codec(tiny_vae()), Codec(tiny_vae())
    tiled.work_in_tiles()
    shown = np.ones(images.shape[:3], bool)
    latents, others = whole.encode(images, shown), tiled.encode(images, shown)
    assert 0 < (latents - others).abs().mean() < 0.05 * latents.abs().mean()
    pixels, others = (codec.decode(latents).astype(int) for codec in (whole, tiled))
    assert 0 < np.abs(pixels - others).mean() < 0.05 * pixels.std()
    small = images[:, :256]
    assert torch.equal(whole.encode(small, shown[:, :256]), tiled.encode(small, shown[:, :256]))


def test_tiles_save_the_autoencoders_memory_and_are_refused_where_there_is_none_to_save(backbone_folder, conditions):
    config = {"num_attention_heads": 12, "attention_head_dim": 128, "ffn_dim": 8960, "num_layers": 30}
    config["vace_layers"] = list(range(0, 30, 2))
    whole, tiled = (
        Footprint.of(config, 1_415_000_000, 735_000_000, (49, 480, 720), 2, tiles) for tiles in (False, True)
    )
    assert whole.codec - 0.5 * GB == pytest.approx((480 * 720) / 256**2 * (tiled.codec - 0.5 * GB))
    assert tiled.needs("resident", False) < whole.needs("resident", False)
    settings = WanSettings(backbone_folder, sampling=Sampling(steps=1), devices=("cpu",))
    wide, small = conditions(5, width=272), conditions(5)
    WanGenerator(replace(settings, tiled=True)).check(wide.scene)
    with pytest.raises(InputError, match="no image here has a side of more than a tile's 256 px; leave --tiles out"):
        WanGenerator(replace(settings, tiled=True)).check(small.scene)
