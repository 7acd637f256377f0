"""What `--backend` and its companions become."""

import os
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from dwgs.cli.backend import BackendChoice
from generator.wan.settings import Lora, Sampling
from generator.wan.tiny import write_tiny_backbone
from generator.wan.wan import WanGenerator


@pytest.fixture(scope="module")
def choice(tmp_path_factory):
    """A network in a few steps, with a borrowed LoRA that changes one bias."""
    folder = tmp_path_factory.mktemp("choice")
    write_tiny_backbone(folder / "backbone")
    save_file({"diffusion_model.head.head.diff_b": torch.ones(64)}, folder / "few.safetensors")
    lora = f"{folder / 'few.safetensors'}:0.5"
    return BackendChoice(
        "vace",
        backbone=folder / "backbone",
        sampling_steps=4,
        shift=5.0,
        guidance=1.0,
        device=("cpu",),
        lora=(lora,),
        tiles=True,
    )


def test_a_choice_reaches_the_network(choice):
    generator = choice.open()
    assert isinstance(generator, WanGenerator)
    settings = generator.settings
    assert settings.sampling == Sampling("unipc", 4, shift=5.0, guidance=1.0)
    assert settings.loras == (Lora(Path(choice.lora[0].removesuffix(":0.5")), 0.5),)
    assert settings.tiled


def test_pixels_depend_on_the_file_of_a_lora(choice):
    before = choice.key()
    os.utime(choice.lora[0].removesuffix(":0.5"), (1, 1))
    assert choice.key() != before
