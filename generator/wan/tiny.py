"""A backbone of toy size with random weights: every line runs on it in seconds, and no picture means anything."""

from pathlib import Path

import torch
from diffusers import AutoencoderKLWan, WanVACETransformer3DModel
from safetensors.torch import save_file

from dwgs.files import new_folder
from generator.wan.weights import PROMPT_FILE

TEXT_DIM, TEXT_TOKENS = 16, 8
"""Of the text that the toy is given."""


def tiny_transformer(seed: int = 0) -> WanVACETransformer3DModel:
    """Wan's transformer, six layers of width 48, with its VACE branch after every other one."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return WanVACETransformer3DModel(
            num_attention_heads=2,
            attention_head_dim=24,
            text_dim=TEXT_DIM,
            freq_dim=32,
            ffn_dim=96,
            num_layers=6,
            vace_layers=[0, 2, 4],
        ).eval()


def tiny_vae(seed: int = 0) -> AutoencoderKLWan:
    """Wan's autoencoder with 4 channels in each layer, and all of its 16 in the middle."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return AutoencoderKLWan(base_dim=4, dim_mult=[1, 1, 1, 1], num_res_blocks=1).eval()


def write_tiny_backbone(path: Path, seed: int = 0) -> None:
    """Write a backbone's folder as the official ones are laid out, its prompt's embedding included."""
    with new_folder(path) as draft:
        tiny_transformer(seed).save_pretrained(draft / "transformer")
        tiny_vae(seed).save_pretrained(draft / "vae")
        generator = torch.Generator().manual_seed(seed)
        text = {name: torch.randn(1, TEXT_TOKENS, TEXT_DIM, generator=generator) for name in ("prompt", "empty")}
        save_file(text, draft / PROMPT_FILE)
