"""Borrowed LoRAs: low-rank changes of a backbone's weights, added to them once, while it is loaded.

Files are known by the names of Wan's own code, of diffusers and of kohya's tools; those that let Wan2.1 work in a few
steps come so. W becomes W + strength alpha / rank up down, and W + strength diff where a file holds whole differences.
"""

import json
import re
from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import torch
from diffusers import WanVACETransformer3DModel
from safetensors import SafetensorError, safe_open
from torch import Tensor

from dwgs.scene.errors import InputError
from generator.wan.settings import Lora

_PREFIX = re.compile(r"^(diffusion_model\.|transformer\.|lora_unet_)")
_KINDS = {
    ".lora_down.weight": ("down", "weight"),
    ".lora_up.weight": ("up", "weight"),
    ".lora_A.weight": ("down", "weight"),
    ".lora_B.weight": ("up", "weight"),
    ".alpha": ("alpha", "weight"),
    ".diff": ("whole", "weight"),
    ".diff_b": ("whole", "bias"),
    ".lora_B.bias": ("whole", "bias"),
    ".diff_m": ("whole", "scale_shift_table"),
}
"""Endings of names: what such a tensor is, and of which parameter of its module."""
_WAN = (
    ("attn1", "self_attn"),
    ("attn2", "cross_attn"),
    ("to_out.0", "o"),
    (".to_", "."),
    ("ffn.net.0.proj", "ffn.0"),
    ("ffn.net.2", "ffn.2"),
    ("norm2", "norm3"),
    ("condition_embedder.time_embedder.linear_1", "time_embedding.0"),
    ("condition_embedder.time_embedder.linear_2", "time_embedding.2"),
    ("condition_embedder.text_embedder.linear_1", "text_embedding.0"),
    ("condition_embedder.text_embedder.linear_2", "text_embedding.2"),
    ("condition_embedder.time_proj", "time_projection.1"),
    ("proj_out", "head.head"),
)
"""Parts of diffusers' names, and what Wan's own code calls them."""

Changes = dict[str, dict[str, str]]
"""For each parameter of the backbone, the file's names of ``down``, ``up`` and ``alpha``, or of the ``whole``."""


def require_lora(lora: Lora, backbone: WanVACETransformer3DModel) -> int:
    """How many parameters of a backbone, which may be a skeleton, a file changes.

    Raises:
        InputError: It is no safetensors file, or not all of it fits.
    """
    shapes = {name: tuple(parameter.shape) for name, parameter in _own(backbone).items()}
    with _opened(lora) as file:
        changes = _changes(lora, list(file.keys()), shapes)
        for parameter, names in changes.items():
            found = {role: tuple(file.get_slice(name).get_shape()) for role, name in names.items()}
            _require_shapes(lora, parameter, shapes[parameter], found)
        _require_plain_alpha(lora, file.metadata() or {})
    return len(changes)


@torch.no_grad()
def fuse(lora: Lora, backbone: WanVACETransformer3DModel) -> None:
    """Add a file that `require_lora` found to fit to a backbone in host memory; sums are taken in float32."""
    parameters = _own(backbone)
    with _opened(lora) as file:
        for name, names in _changes(lora, list(file.keys()), parameters).items():
            tensors = {role: file.get_tensor(key).float() for role, key in names.items()}
            parameter = parameters[name]
            parameter.copy_(parameter.float() + lora.strength * _change(tensors))


def _change(tensors: Mapping[str, Tensor]) -> Tensor:
    if "whole" in tensors:
        return tensors["whole"]
    down, up = tensors["down"], tensors["up"]
    rank = len(down)
    return float(tensors.get("alpha", torch.tensor(rank))) / rank * (up @ down)


def _own(backbone: WanVACETransformer3DModel) -> dict[str, Tensor]:
    """The backbone's parameters without its VACE branch, which an adapter may replace."""
    return {name: p for name, p in backbone.named_parameters() if not name.startswith("vace_")}


def _changes(lora: Lora, keys: list[str], parameters: Mapping[str, Any]) -> Changes:
    modules = _modules(parameters)
    changes: Changes = defaultdict(dict)
    for key in keys:
        name = _PREFIX.sub("", key)
        ending = next((ending for ending in _KINDS if f".{name}".endswith(ending)), None)
        if ending is None:
            raise InputError(
                f"'{lora.path}' holds '{key}', which is none of {', '.join(e[1:] for e in _KINDS)}; "
                "give a LoRA in one of these forms"
            )
        role, leaf = _KINDS[ending]
        module = modules.get(f".{name}".removesuffix(ending)[1:])
        parameter = leaf if module == "" else f"{module}.{leaf}"
        if module is None or parameter not in parameters:
            raise InputError(
                f"'{lora.path}' changes '{key}', which this backbone has not; give a LoRA for Wan2.1 text-to-video, "
                "of the backbone's size"
            )
        changes[parameter][role] = key
    if not changes:
        raise InputError(f"'{lora.path}' changes nothing; give a LoRA for Wan2.1 text-to-video")
    return changes


def _modules(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Modules by every name that a file may call them."""
    names = {}
    for module in {parameter.rpartition(".")[0] for parameter in parameters}:
        wan = module or "head"
        for ours, theirs in _WAN:
            wan = wan.replace(ours, theirs)
        names |= {module: module, wan: module, wan.replace(".", "_"): module}
    return names


def _require_shapes(lora: Lora, parameter: str, shape: tuple[int, ...], found: Mapping[str, tuple[int, ...]]) -> None:
    if set(found) == {"whole"}:
        fits, says = found["whole"] == shape, f"by {list(found['whole'])}"
    elif {"down", "up"} <= set(found) <= {"down", "up", "alpha"}:
        down, up = found["down"], found["up"]
        fits = len(shape) == len(down) == len(up) == 2 and (up[0], down[1]) == shape and up[1] == down[0] > 0
        fits = fits and found.get("alpha", ()) in ((), (1,))
        says = f"by {list(up)} times {list(down)}"
    else:
        fits, says = False, f"by {' and '.join(sorted(found))} alone"
    if not fits:
        raise InputError(
            f"'{lora.path}' changes {parameter} {says}, this backbone's is {list(shape)}; give a LoRA for Wan2.1 "
            "text-to-video, of the backbone's size"
        )


def _require_plain_alpha(lora: Lora, metadata: Mapping[str, str]) -> None:
    """diffusers may keep alpha beside the tensors, by patterns of names; then alpha / rank must be 1 throughout."""
    try:
        settings = json.loads(metadata.get("lora_adapter_metadata", "{}"))
        odd = settings.get("transformer.alpha_pattern") or settings.get("transformer.rank_pattern")
        plain = not odd and settings.get("transformer.lora_alpha") == settings.get("transformer.r")
    except (ValueError, RecursionError, AttributeError):
        plain = False
    if not plain:
        raise InputError(
            f"'{lora.path}' states alpha in its metadata, which is not read; give one whose alpha is its rank"
        )


def _opened(lora: Lora) -> Any:
    try:
        return safe_open(lora.path, framework="pt")
    except (SafetensorError, OSError) as error:
        raise InputError(f"'{lora.path}' is damaged or no safetensors file ({error}); download it again") from None
