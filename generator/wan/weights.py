"""A Wan2.1-VACE folder in diffusers' layout: checked at once, loaded when it is needed."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from diffusers import AutoencoderKLWan, WanVACETransformer3DModel
from diffusers.utils import logging
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from dwgs.files import new_file
from dwgs.scene.errors import InputError
from generator.wan.encode import Codec
from generator.wan.folder import config_of, require_tensors, skeleton

PROMPT = "A realistic autonomous driving scene"
"""The paper's, always the same."""
PROMPT_FILE = "prompt.safetensors"
"""In the backbone's folder: the embedding of the prompt and of no prompt, computed once."""
TEXT_TOKENS = 512
"""Texts are padded with zeros to this length."""


@dataclass(frozen=True)
class Text:
    """Embeddings [1, L, D] of the fixed prompt and of no text."""

    prompt: Tensor
    empty: Tensor


@dataclass(frozen=True)
class Backbone:
    """A folder with ``transformer/``, ``vae/``, and ``text_encoder/`` with ``tokenizer/`` or ``prompt.safetensors``."""

    folder: Path
    config: dict[str, Any]
    """Of the transformer."""

    @staticmethod
    def open(folder: Path) -> "Backbone":
        """Check a folder without loading it.

        Raises:
            InputError: It is no Wan2.1-VACE folder, or a file is missing, cut short or of another shape.
        """
        folder = Path(folder)
        config = config_of(folder / "transformer")
        if config.get("_class_name") != "WanVACETransformer3DModel":
            raise InputError(
                f"a backbone is a WanVACETransformer3DModel, '{folder / 'transformer'}' is {config.get('_class_name')}"
                "; give a Wan2.1-VACE folder in diffusers' layout"
            )
        vae = config_of(folder / "vae")
        if vae.get("_class_name") != "AutoencoderKLWan":
            raise InputError(
                f"a backbone's autoencoder is AutoencoderKLWan, '{folder / 'vae'}' is {vae.get('_class_name')}"
            )
        backbone = Backbone(folder, config)
        require_tensors(folder / "transformer", backbone.skeleton)
        require_tensors(folder / "vae", skeleton(AutoencoderKLWan, vae, folder / "vae"))
        if not (folder / PROMPT_FILE).is_file() and not (folder / "text_encoder").is_dir():
            raise InputError(
                f"'{folder}' has neither {PROMPT_FILE} nor text_encoder/ to compute it; download the text encoder once"
            )
        if (folder / PROMPT_FILE).is_file():
            backbone.load_text()
        return backbone

    @cached_property
    def skeleton(self) -> WanVACETransformer3DModel:
        """The transformer without weights: names, shapes and nothing else."""
        return skeleton(WanVACETransformer3DModel, self.config, self.folder / "transformer")

    @property
    def parameters(self) -> tuple[int, int]:
        """Of the whole transformer, and of its VACE branch."""
        sizes = {name: p.numel() for name, p in self.skeleton.named_parameters()}
        return sum(sizes.values()), sum(size for name, size in sizes.items() if name.startswith("vace_"))

    def load_transformer(self, dtype: torch.dtype = torch.float32) -> WanVACETransformer3DModel:
        """The transformer with its VACE branch; what must stay float32 does."""
        return _quietly(WanVACETransformer3DModel, self.folder / "transformer", dtype)

    def load_codec(self, device: str = "cpu", dtype: torch.dtype = torch.float32) -> Codec:
        """The autoencoder."""
        return Codec(_quietly(AutoencoderKLWan, self.folder / "vae", dtype).to(device))

    def load_text(self) -> Text:
        """The embeddings; where they are not stored yet, the text encoder computes them, and is let go again.

        Raises:
            InputError: What is stored is damaged, or belongs to another backbone.
        """
        path = self.folder / PROMPT_FILE
        if not path.is_file():
            embeddings = _embed({"prompt": PROMPT, "empty": ""}, self.folder)
            with new_file(path) as draft:
                save_file(embeddings, draft)
        try:
            stored = load_file(path)
            text = Text(stored["prompt"], stored["empty"])
        except (SafetensorError, KeyError) as error:
            raise InputError(f"'{path}' is damaged ({error}); delete it, it is computed again") from None
        for tensor in (text.prompt, text.empty):
            if tensor.ndim != 3 or tensor.shape[-1] != self.config["text_dim"]:
                raise InputError(
                    f"text has {self.config['text_dim']} numbers per token here, '{path}' has {list(tensor.shape)}; "
                    "delete it, it is computed again"
                )
        return text


def _embed(texts: dict[str, str], folder: Path) -> dict[str, Tensor]:
    """Last hidden states [1, 512, D] of UMT5, zero past the end of each text, as bfloat16."""
    from transformers import AutoTokenizer, UMT5EncoderModel

    tokenizer = AutoTokenizer.from_pretrained(folder / "tokenizer", local_files_only=True)
    encoder = UMT5EncoderModel.from_pretrained(
        folder / "text_encoder", dtype=torch.bfloat16, use_safetensors=True, local_files_only=True
    ).eval()
    embeddings = {}
    for name, text in texts.items():
        tokens = tokenizer(text, padding="max_length", max_length=TEXT_TOKENS, truncation=True, return_tensors="pt")
        with torch.no_grad():
            states = encoder(tokens.input_ids, tokens.attention_mask).last_hidden_state
        embeddings[name] = (states * tokens.attention_mask[..., None]).to(torch.bfloat16).contiguous()
    return embeddings


def _quietly(kind: Any, folder: Path, dtype: torch.dtype) -> Any:
    """Load what was checked before, without the library's advice about it."""
    before = logging.get_verbosity()
    logging.set_verbosity_error()
    try:
        model = kind.from_pretrained(folder, torch_dtype=dtype, use_safetensors=True, local_files_only=True)
    finally:
        logging.set_verbosity(before)
    return model.eval().requires_grad_(False)
