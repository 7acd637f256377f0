"""LoRA files in every naming that is known, fused into a backbone of toy size."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from dwgs.scene import InputError
from generator.wan.lora import fuse, require_lora
from generator.wan.settings import Lora, Sampling, WanSettings
from generator.wan.tiny import tiny_transformer
from generator.wan.wan import WanGenerator

RANK = 4
MODULES = {  # of Wan's own code, and of diffusers
    "blocks.0.self_attn.q": "blocks.0.attn1.to_q",
    "blocks.1.self_attn.o": "blocks.1.attn1.to_out.0",
    "blocks.2.cross_attn.k": "blocks.2.attn2.to_k",
    "blocks.3.ffn.0": "blocks.3.ffn.net.0.proj",
    "blocks.5.ffn.2": "blocks.5.ffn.net.2",
    "time_embedding.0": "condition_embedder.time_embedder.linear_1",
    "text_embedding.2": "condition_embedder.text_embedder.linear_2",
    "time_projection.1": "condition_embedder.time_proj",
    "head.head": "proj_out",
}


def factors():
    """By diffusers' names, down [rank, in] and up [out, rank]."""
    random = torch.Generator().manual_seed(0)
    weights = dict(tiny_transformer().named_parameters())
    shapes = {name: weights[f"{name}.weight"].shape for name in MODULES.values()}
    return {
        name: (torch.randn(RANK, columns, generator=random), torch.randn(rows, RANK, generator=random))
        for name, (rows, columns) in shapes.items()
    }


def tensors_of(form):
    """The same LoRA under the names of a form; its scale is 1 where the form has no alpha, and 1 / 2 elsewhere."""
    tensors = {}
    for wan, ours in MODULES.items():
        down, up = factors()[ours]
        stem, names, alpha = {
            "wan": (f"diffusion_model.{wan}", ("lora_down", "lora_up"), RANK / 2),
            "wan-ab": (f"diffusion_model.{wan}", ("lora_A", "lora_B"), None),
            "diffusers": (f"transformer.{ours}", ("lora_A", "lora_B"), None),
            "kohya": (f"lora_unet_{wan.replace('.', '_')}", ("lora_down", "lora_up"), RANK / 2),
        }[form]
        tensors |= {f"{stem}.{names[0]}.weight": down, f"{stem}.{names[1]}.weight": up}
        if alpha is not None:
            tensors[f"{stem}.alpha"] = torch.tensor(alpha)
    return tensors


@pytest.fixture
def lora(tmp_path):
    def write(tensors, strength=1.0, metadata=None):
        save_file(tensors, tmp_path / "lora.safetensors", metadata)
        return Lora(tmp_path / "lora.safetensors", strength)

    return write


@pytest.mark.parametrize("form", ["wan", "wan-ab", "diffusers", "kohya"])
@pytest.mark.parametrize("strength", [1.0, -0.3])
def test_it_adds_strength_alpha_over_rank_up_down_and_changes_nothing_else(lora, form, strength):
    scale = 0.5 if form in ("wan", "kohya") else 1.0
    before, after = tiny_transformer(), tiny_transformer()
    file = lora(tensors_of(form), strength)
    assert require_lora(file, after) == len(MODULES)
    fuse(file, after)
    added = {f"{name}.weight": strength * scale * up.double() @ down.double() for name, (down, up) in factors().items()}
    for (name, old), new in zip(before.named_parameters(), after.parameters(), strict=True):
        if name in added:
            torch.testing.assert_close(new.double(), old.double() + added[name], atol=1e-5, rtol=1e-6)
        else:
            assert torch.equal(new, old), name


def test_whole_differences_reach_weights_biases_norms_and_modulations(lora):
    whole = {
        "blocks.0.self_attn.norm_q.diff": "blocks.0.attn1.norm_q.weight",
        "blocks.0.norm3.diff": "blocks.0.norm2.weight",
        "blocks.0.norm3.diff_b": "blocks.0.norm2.bias",
        "blocks.1.cross_attn.v.diff_b": "blocks.1.attn2.to_v.bias",
        "blocks.2.diff_m": "blocks.2.scale_shift_table",
        "head.diff_m": "scale_shift_table",
        "head.head.diff": "proj_out.weight",
        "patch_embedding.diff": "patch_embedding.weight",
    }
    before, after = dict(tiny_transformer().named_parameters()), tiny_transformer()
    tensors = {f"diffusion_model.{key}": torch.full_like(before[name], 0.25) for key, name in whole.items()}
    file = lora(tensors, 2.0)
    assert require_lora(file, after) == len(whole)
    fuse(file, after)
    changed = {name for name, p in after.named_parameters() if not torch.equal(p, before[name])}
    assert changed == set(whole.values())
    for name in changed:
        torch.testing.assert_close(after.get_parameter(name), before[name] + 0.5)


def test_sums_are_rounded_once_where_weights_have_16_bits(lora):
    whole, half = tiny_transformer(), tiny_transformer().to(torch.bfloat16)
    file = lora({name: tensor / 100 for name, tensor in tensors_of("diffusers").items()})
    exact = half.proj_out.weight.float() + 1e-4 * factors()["proj_out"][1] @ factors()["proj_out"][0]
    fuse(file, half)
    assert torch.equal(half.proj_out.weight, exact.to(torch.bfloat16))
    assert whole.proj_out.weight.dtype == torch.float32


DOWN, UP = torch.ones(RANK, 48), torch.ones(48, RANK)
Q = "diffusion_model.blocks.0.self_attn.q"


@pytest.mark.parametrize(
    ("tensors", "said"),
    [
        ({"diffusion_model.blocks.0.cross_attn.k_img.lora_down.weight": DOWN}, "k_img.*which this backbone has not"),
        ({"diffusion_model.blocks.9.self_attn.q.lora_down.weight": DOWN}, "which this backbone has not"),
        ({"diffusion_model.vace_blocks.0.self_attn.q.lora_down.weight": DOWN}, "which this backbone has not"),
        ({f"{Q}.dora_scale": DOWN}, "dora_scale', which is none of lora_down.weight"),
        ({f"{Q}.lora_down.weight": DOWN}, r"changes blocks.0.attn1.to_q.weight by down alone"),
        ({f"{Q}.lora_down.weight": DOWN, f"{Q}.lora_up.weight": UP, f"{Q}.diff": DOWN}, "by down and up and whole"),
        (
            {f"{Q}.lora_down.weight": DOWN, f"{Q}.lora_up.weight": UP[:40]},
            r"by \[40, 4\] times .* is \[48, 48\]",
        ),
        ({f"{Q}.lora_down.weight": DOWN[:2], f"{Q}.lora_up.weight": UP}, r"by \[48, 4\] times \[2, 48\]"),
        ({f"{Q}.diff_b": DOWN}, r"changes blocks.0.attn1.to_q.bias by \[4, 48\]"),
        ({}, "changes nothing"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(lora, tensors, said):
    with pytest.raises(InputError, match=said):
        require_lora(lora({name: tensor.clone() for name, tensor in tensors.items()}), tiny_transformer())


def test_a_file_that_is_none_and_an_alpha_that_is_not_read_are_refused(lora, tmp_path):
    (tmp_path / "text").write_text("no weights")
    for path in (tmp_path / "text", tmp_path / "nothing"):
        with pytest.raises(InputError, match="damaged or no safetensors file"):
            require_lora(Lora(path), tiny_transformer())
    for alpha, fits in ((8, False), (4, True)):
        settings = {"transformer.lora_alpha": alpha, "transformer.r": 4}
        file = lora(tensors_of("diffusers"), metadata={"lora_adapter_metadata": json.dumps(settings)})
        if fits:
            require_lora(file, tiny_transformer())
        else:
            with pytest.raises(InputError, match="states alpha in its metadata"):
                require_lora(file, tiny_transformer())


def test_a_file_is_named_with_its_strength_behind_a_colon(tmp_path):
    assert (Lora.of("a.safetensors").path.name, Lora.of("a.safetensors").strength) == ("a.safetensors", 1.0)
    assert (Lora.of("b:c:0.53").path.name, Lora.of("b:c:0.53").strength) == ("b:c", 0.53)
    assert Lora.of("b:c").path.name == "b:c"
    with pytest.raises(InputError, match="strength is a number, 'b' is given nan"):
        Lora.of("b:nan")


def test_a_generator_is_told_of_it_and_strength_0_changes_no_pixel(lora, backbone_folder, adapter_folder, conditions):
    def pixels(*loras):
        generator = WanGenerator(replace(settings, loras=loras))
        return np.stack([f.pixels for f in generator.generate(conditions(5), 0).all_frames()])

    settings = WanSettings(backbone_folder, adapter_folder, sampling=Sampling(steps=2, guidance=1), devices=("cpu",))
    # the last one is what an adapter knows its backbone by
    file = lora({**tensors_of("wan"), "diffusion_model.head.diff_m": torch.full((1, 2, 48), 0.1)})
    plain = pixels()
    assert np.array_equal(pixels(replace(file, strength=0.0)), plain)
    assert not np.array_equal(pixels(file), plain)
    notes = WanGenerator(replace(settings, loras=(file,))).check(conditions(5).scene)
    assert notes[-2:] == [
        f"'lora.safetensors' at strength 1 changes the backbone in {len(MODULES) + 1} places",
        "2 steps are 2 runs of the network for each clip",
    ]
