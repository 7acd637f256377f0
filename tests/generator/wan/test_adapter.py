import json

import pytest
import torch
from diffusers import WanTransformer3DModel, WanVACETransformer3DModel

from dwgs.scene import InputError
from generator.wan.adapter import PointAdapter, in_channels, load_adapter, new_adapter, shape_of
from generator.wan.tiny import TEXT_DIM, tiny_transformer

LATENT = (1, 16, 3, 4, 6)


def forward(transformer, control, seed=1):
    """The velocity of a small latent video under some condition."""
    generator = torch.Generator().manual_seed(seed)
    return transformer(
        hidden_states=torch.randn(LATENT, generator=generator),
        timestep=torch.tensor([500.0]),
        encoder_hidden_states=torch.randn(1, 8, TEXT_DIM, generator=generator),
        control_hidden_states=control,
        return_dict=False,
    )[0]


@pytest.fixture
def control():
    """[inactive 16 | point 16 | reactive mask 64 | point mask 64]."""
    return torch.randn(1, 160, *LATENT[2:], generator=torch.Generator().manual_seed(2))


def attached(init, **options):
    transformer = tiny_transformer()
    adapter = new_adapter(transformer, init, **options)
    adapter.attach(transformer)
    return transformer, adapter


def test_the_adapter_of_the_14b_backbone_has_the_papers_3_billion_parameters():
    with torch.device("meta"):
        backbone = WanVACETransformer3DModel()
        adapter = PointAdapter(shape_of(backbone.config), "none", list(backbone.config["vace_layers"]))
    assert adapter.config["layers"] == [0, 5, 10, 15, 20, 25, 30, 35]
    assert in_channels(adapter.config["backbone"]) == 160
    assert adapter.num_parameters() == pytest.approx(3.0504e9, rel=1e-4)


def test_started_from_vace_it_is_vace_with_the_points_as_reactive_video(control):
    with torch.no_grad():
        expected = forward(tiny_transformer(), control[:, :96])
        torch.testing.assert_close(forward(attached("vace")[0], control), expected, atol=1e-6, rtol=0)


def test_started_from_zero_it_is_the_bare_backbone(control):
    transformer, _ = attached("zero")
    bare = WanTransformer3DModel.from_config({k: v for k, v in transformer.config.items() if not k.startswith("vace")})
    bare.load_state_dict({k: v for k, v in transformer.state_dict().items() if not k.startswith("vace")})
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        expected = bare.eval()(
            hidden_states=torch.randn(LATENT, generator=generator),
            timestep=torch.tensor([500.0]),
            encoder_hidden_states=torch.randn(1, 8, TEXT_DIM, generator=generator),
            return_dict=False,
        )[0]
        assert torch.equal(forward(transformer, control), expected)


def test_only_the_adapter_has_gradients_with_and_without_checkpointing(control):
    gradients = []
    for checkpointed in (False, True):
        transformer, adapter = attached("vace")
        if checkpointed:
            transformer.enable_gradient_checkpointing()
        forward(transformer, control).square().mean().backward()
        with_gradient = {id(p) for p in transformer.parameters() if p.grad is not None}
        assert with_gradient == {id(p) for p in adapter.parameters()}
        gradients.append([p.grad for p in adapter.parameters()])
    for ours, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs)


def test_the_point_mask_starts_unheard_and_is_learnt(control):
    transformer, adapter = attached("vace")
    forward(transformer, control).square().mean().backward()
    assert not adapter.patch_embedding.weight[:, 96:].any()
    assert adapter.patch_embedding.weight.grad[:, 96:].any()


def test_a_folder_comes_back_bit_by_bit(tmp_path, control):
    transformer, adapter = attached("random", layers=[0, 3])
    adapter.save(tmp_path / "adapter")
    again = tiny_transformer()
    loaded = load_adapter(tmp_path / "adapter", again)
    assert loaded.config["layers"] == [0, 3]
    for (name, ours), (_, theirs) in zip(adapter.state_dict().items(), loaded.state_dict().items(), strict=True):
        assert torch.equal(ours, theirs), name
    loaded.attach(again)
    with torch.no_grad():
        assert torch.equal(forward(again, control), forward(transformer, control))


@pytest.fixture
def saved(tmp_path):
    attached("zero")[1].save(tmp_path / "adapter")
    return tmp_path / "adapter"


def test_another_backbone_is_refused_by_name(saved):
    other = WanVACETransformer3DModel.from_config({**tiny_transformer().config, "ffn_dim": 128})
    with pytest.raises(InputError, match="made for a backbone with ffn_dim 96, this one has 128"):
        load_adapter(saved, other)
    with pytest.raises(InputError, match="of the same shape, has"):
        load_adapter(saved, tiny_transformer(seed=1))


def test_a_whole_vace_folder_is_no_adapter(backbone_folder):
    with pytest.raises(InputError, match="no PointAdapter but WanVACETransformer3DModel with 96 condition channels"):
        load_adapter(backbone_folder / "transformer", tiny_transformer())


def test_a_damaged_folder_is_refused(saved):
    weights = saved / "diffusion_pytorch_model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(InputError, match="damaged or cut short"):
        load_adapter(saved, tiny_transformer())
    weights.unlink()
    with pytest.raises(InputError, match="there are none in"):
        load_adapter(saved, tiny_transformer())


def test_a_config_that_does_not_fit_its_weights_is_refused(saved):
    config = json.loads((saved / "config.json").read_text())
    (saved / "config.json").write_text(json.dumps({**config, "layers": [0, 1, 2, 3]}))
    with pytest.raises(InputError, match=r"lacks the tensor blocks\.3"):
        load_adapter(saved, tiny_transformer())
    (saved / "config.json").write_text(json.dumps({**config, "layers": [0] * 10**6}))
    with pytest.raises(InputError, match="layers of a model has at most 256 entries"):
        load_adapter(saved, tiny_transformer())
    (saved / "config.json").write_text(json.dumps({**config, "backbone": None}))
    with pytest.raises(InputError, match="says None for backbone"):
        load_adapter(saved, tiny_transformer())
    (saved / "config.json").write_text(json.dumps({**config, "null": "zero latents"}))
    with pytest.raises(InputError, match="says zero latents; train anew"):
        load_adapter(saved, tiny_transformer())


def test_impossible_layers_are_refused():
    for layers in ([], [1, 2], [0, 6], [0, 0]):
        with pytest.raises(InputError, match="begin with 0 and lie among the backbone's 6"):
            new_adapter(tiny_transformer(), "random", layers)
    with pytest.raises(InputError, match=r"copies the VACE branch at layers \[0, 2, 4\], not \[0, 3\]"):
        new_adapter(tiny_transformer(), "vace", [0, 3])
    with pytest.raises(InputError, match="a VACE branch of 96 channels, this backbone's has 160"):
        new_adapter(attached("vace")[0], "vace")
