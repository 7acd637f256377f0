import shutil

import pytest
import torch
from tokenizers import Tokenizer, models, pre_tokenizers
from transformers import PreTrainedTokenizerFast, UMT5Config, UMT5EncoderModel

from dwgs.scene import InputError
from generator.wan import weights
from generator.wan.tiny import TEXT_DIM
from generator.wan.weights import PROMPT, TEXT_TOKENS, Backbone


@pytest.fixture
def folder(backbone_folder, tmp_path):
    """A backbone with a text encoder of toy size in place of the stored embedding."""
    shutil.copytree(backbone_folder, tmp_path / "backbone")
    folder = tmp_path / "backbone"
    (folder / weights.PROMPT_FILE).unlink()
    words = {word: i for i, word in enumerate(["<pad>", "<unk>", *PROMPT.split()])}
    tokenizer = Tokenizer(models.WordLevel(words, unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    PreTrainedTokenizerFast(tokenizer_object=tokenizer, pad_token="<pad>", unk_token="<unk>").save_pretrained(
        folder / "tokenizer"
    )
    config = UMT5Config(vocab_size=16, d_model=TEXT_DIM, d_kv=8, d_ff=16, num_layers=1, num_heads=2)
    UMT5EncoderModel(config).save_pretrained(folder / "text_encoder")
    return folder


def test_the_prompt_is_embedded_once_and_stored(folder):
    text = Backbone.open(folder).load_text()
    assert text.prompt.shape == (1, TEXT_TOKENS, TEXT_DIM)
    words = len(PROMPT.split())
    assert text.prompt[:, :words].any()
    assert not text.prompt[:, words:].any()
    assert not text.empty.any()
    shutil.rmtree(folder / "text_encoder")
    shutil.rmtree(folder / "tokenizer")
    again = Backbone.open(folder).load_text()
    assert torch.equal(again.prompt, text.prompt)


def test_a_stored_embedding_that_is_damaged_or_another_s_is_refused(folder):
    file = folder / weights.PROMPT_FILE
    file.write_bytes(b"half")
    with pytest.raises(InputError, match=r"is damaged .*; delete it, it is computed again"):
        Backbone.open(folder).load_text()
    weights.save_file({name: torch.zeros(1, 4, 8) for name in ("prompt", "empty")}, file)
    with pytest.raises(InputError, match=r"text has 16 numbers per token here, .* has \[1, 4, 8\]"):
        Backbone.open(folder).load_text()
