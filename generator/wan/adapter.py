"""PointAdapter: the branch that tells a frozen Wan backbone where the vehicle's points are (paper, sec. 3.2).

It takes the place of the backbone's own VACE branch: the same blocks at the same layers, with a wider patch
embedding. No forward pass is written here, so that gradient checkpointing, offloading, casting and compiling work
as they do for the backbone.
"""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from diffusers import ConfigMixin, ModelMixin, WanVACETransformer3DModel
from diffusers.configuration_utils import register_to_config
from diffusers.models.transformers.transformer_wan_vace import WanVACETransformerBlock
from torch import Tensor, nn

from dwgs.files import new_folder
from dwgs.scene.errors import InputError
from generator.wan.encode import MASK_CHANNELS
from generator.wan.folder import config_of, require_tensors, skeleton
from generator.wan.settings import Init, MaskTime

CHANNELS = ("inactive", "point", "reactive mask", "point mask")
"""Order of what the adapter sees: latents, latents, 64 channels, 64 channels."""
NULL = "grey pixels, then encoded"
"""What stands for no points, in training and in guidance alike."""

_SHAPE = (
    "num_layers",
    "num_attention_heads",
    "attention_head_dim",
    "ffn_dim",
    "in_channels",
    "patch_size",
    "cross_attn_norm",
    "qk_norm",
    "eps",
    "added_kv_proj_dim",
)


class PointAdapter(ModelMixin, ConfigMixin):
    """VACE blocks behind a patch embedding of [inactive | point | reactive mask | point mask]; 160 channels for Wan2.1.

    Its config records what it was trained with: the backbone's shape and fingerprint, and every rule by which
    conditions become channels.
    """

    _keep_in_fp32_modules = ["scale_shift_table", "norm1", "norm2", "norm3"]  # noqa: RUF012  (as in the backbone)
    _no_split_modules = ["WanVACETransformerBlock"]  # noqa: RUF012

    @register_to_config
    def __init__(
        self,
        backbone: dict[str, Any],
        fingerprint: str,
        layers: list[int],
        init: Init = "vace",
        mask_time: MaskTime = "group",
        channels: tuple[str, ...] = CHANNELS,
        null: str = NULL,
    ) -> None:
        super().__init__()
        dim = backbone["num_attention_heads"] * backbone["attention_head_dim"]
        patch = tuple(backbone["patch_size"])
        self.patch_embedding = nn.Conv3d(in_channels(backbone), dim, patch, patch)
        self.blocks = nn.ModuleList(
            WanVACETransformerBlock(
                dim,
                backbone["ffn_dim"],
                backbone["num_attention_heads"],
                backbone["qk_norm"],
                backbone["cross_attn_norm"],
                backbone["eps"],
                backbone["added_kv_proj_dim"],
                apply_input_projection=number == 0,
                apply_output_projection=True,
            )
            for number in range(len(layers))
        )

    @property
    def mask_time(self) -> MaskTime:
        """How masks of frames become masks of latent frames."""
        return self.config["mask_time"]

    def attach(self, transformer: WanVACETransformer3DModel) -> None:
        """Take the place of the transformer's VACE branch; of both, only the adapter has gradients from now on.

        The modules are shared, not copied: what trains through the transformer trains here.

        Raises:
            InputError: It was made for another backbone.
        """
        require_fit(self.config, transformer.config, fingerprint_of(transformer.scale_shift_table))
        transformer.requires_grad_(False)
        transformer.vace_patch_embedding = self.patch_embedding
        transformer.vace_blocks = self.blocks
        layers = list(self.config["layers"])
        transformer.register_to_config(vace_layers=layers, vace_in_channels=self.patch_embedding.in_channels)
        self.requires_grad_(True)

    def save(self, path: Path) -> None:
        """Write a folder of ``config.json`` and safetensors that `load_adapter` reads: whole or not at all."""
        with new_folder(path) as draft:
            self.save_pretrained(draft)
            mode = (draft / "config.json").stat().st_mode
            for file in draft.glob("*.safetensors"):
                file.chmod(mode)  # the library leaves weights to their owner alone


def new_adapter(
    transformer: WanVACETransformer3DModel,
    init: Init = "vace",
    layers: list[int] | None = None,
    mask_time: MaskTime = "group",
    seed: int = 0,
) -> PointAdapter:
    """An adapter for a backbone that still has its own VACE branch.

    Args:
        transformer: The backbone.
        init: ``vace``: step 0 is VACE with the point render as its reactive video. ``zero``: the same with every
            output projection zeroed, so that step 0 is the bare backbone. ``random``: PyTorch's own.
        layers: Blocks of the backbone after which a hint is added; by default those of its VACE branch, which the
            first two take their weights from.
        mask_time: How masks of frames become masks of latent frames.
        seed: Of ``random``.

    Raises:
        InputError: The layers cannot be, or the branch is no VACE branch.
    """
    config = transformer.config
    layers = list(config["vace_layers"]) if layers is None else sorted(layers)
    if not layers or layers[0] != 0 or layers[-1] >= config["num_layers"] or len(set(layers)) < len(layers):
        raise InputError(
            f"an adapter's layers begin with 0 and lie among the backbone's {config['num_layers']}, got {layers}"
        )
    if init != "random":
        if layers != list(config["vace_layers"]):
            raise InputError(
                f"'{init}' copies the VACE branch at layers {list(config['vace_layers'])}, not {layers}; "
                "leave the layers out, or start from 'random'"
            )
        if config["vace_in_channels"] != 2 * config["in_channels"] + MASK_CHANNELS:
            raise InputError(
                f"'{init}' copies a VACE branch of {2 * config['in_channels'] + MASK_CHANNELS} channels, this "
                f"backbone's has {config['vace_in_channels']}; load the official folder"
            )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        adapter = PointAdapter(shape_of(config), fingerprint_of(transformer.scale_shift_table), layers, init, mask_time)
    if init != "random":
        _copy_branch(transformer, adapter)
    if init == "zero":
        for name, parameter in adapter.blocks.named_parameters():
            if ".proj_out." in name:
                nn.init.zeros_(parameter)
    return adapter


@torch.no_grad()
def _copy_branch(transformer: WanVACETransformer3DModel, adapter: PointAdapter) -> None:
    """[inactive | reactive | mask] become [inactive | point | reactive mask]; the point mask starts unheard."""
    known = transformer.vace_patch_embedding
    adapter.patch_embedding.weight.zero_()
    adapter.patch_embedding.weight[:, : known.in_channels] = known.weight
    if adapter.patch_embedding.bias is not None and known.bias is not None:
        adapter.patch_embedding.bias.copy_(known.bias)
    adapter.blocks.load_state_dict(transformer.vace_blocks.state_dict())


def load_adapter(
    path: Path, transformer: WanVACETransformer3DModel, dtype: torch.dtype = torch.float32
) -> PointAdapter:
    """The adapter that `PointAdapter.save` wrote; it is not attached yet.

    Raises:
        InputError: The folder is no adapter, is incomplete, or was made for another backbone.
    """
    path = Path(path)
    require_adapter(path, transformer.config, fingerprint_of(transformer.scale_shift_table))
    return PointAdapter.from_pretrained(path, torch_dtype=dtype, use_safetensors=True, local_files_only=True)


def require_adapter(path: Path, backbone: Mapping[str, Any], fingerprint: str) -> dict[str, Any]:
    """The config of an adapter's folder, once it is clear that the folder is whole and fits a backbone.

    Args:
        path: Of the adapter.
        backbone: The backbone's config.
        fingerprint: The backbone's, see `fingerprint_of`.

    Raises:
        InputError: It is no adapter, is incomplete, or was made for another backbone.
    """
    config = adapter_config(path)
    require_fit(config, backbone, fingerprint, path)
    require_tensors(path, skeleton(PointAdapter, config, path))
    return config


def adapter_config(path: Path) -> dict[str, Any]:
    """What ``config.json`` of an adapter folder says; raises `InputError` unless it is an adapter of this version."""
    config = config_of(path)
    kind = config.get("_class_name")
    if kind != "PointAdapter":
        raise InputError(
            f"'{path}' is no PointAdapter but {kind} with {config.get('vace_in_channels')} condition channels; "
            "give the folder that `dwgs train` wrote, or take --backend vace, which needs none"
        )
    for key, type_ in (("backbone", dict), ("fingerprint", str), ("layers", list), ("mask_time", str)):
        if not isinstance(config.get(key), type_):
            raise InputError(
                f"'{path}/config.json' says {config.get(key)} for {key}; give the folder as it was written"
            )
    for key, ours in (("channels", list(CHANNELS)), ("null", NULL)):
        if config.get(key) != ours:
            raise InputError(f"this version's adapters have {key} {ours}, '{path}' says {config.get(key)}; train anew")
    return config


def require_fit(
    config: Mapping[str, Any], backbone: Mapping[str, Any], fingerprint: str, path: Path | None = None
) -> None:
    """Raise `InputError` unless an adapter of that config was made for a backbone of that config and fingerprint."""
    who = f"the adapter in '{path}'" if path else "the adapter"
    for key, value in shape_of(backbone).items():
        if config["backbone"].get(key) != value:
            raise InputError(
                f"{who} was made for a backbone with {key} {config['backbone'].get(key)}, this one has {value}; "
                "give the backbone it was trained on"
            )
    if config["fingerprint"] != fingerprint:
        raise InputError(
            f"{who} was made for the backbone with fingerprint {config['fingerprint']}, this one, of the same "
            f"shape, has {fingerprint}; give the backbone it was trained on"
        )


def parameters_of(config: Mapping[str, Any], path: Path) -> int:
    """How many an adapter of that config has."""
    return skeleton(PointAdapter, config, path).num_parameters()


def shape_of(config: Mapping[str, Any]) -> dict[str, Any]:
    """What an adapter has in common with its backbone, as JSON values."""
    return {key: list(v) if isinstance(v := config[key], tuple) else v for key in _SHAPE}


def in_channels(backbone: Mapping[str, Any]) -> int:
    """Two latents and two packed masks."""
    return 2 * backbone["in_channels"] + 2 * MASK_CHANNELS


def fingerprint_of(scale_shift_table: Tensor) -> str:
    """Tells one backbone from another of the same shape by its last modulation, at whatever precision it is loaded."""
    if scale_shift_table.is_meta:
        return "none"
    rounded = scale_shift_table.detach().to("cpu", torch.bfloat16).view(torch.int16)
    return hashlib.sha256(rounded.numpy().tobytes()).hexdigest()[:16]
