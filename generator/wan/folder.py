"""Folders of models as diffusers lays them out: read with distrust, before any of it is loaded."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from diffusers import ConfigMixin
from safetensors import SafetensorError, safe_open

from dwgs.scene.errors import InputError

_MOST_JSON = 2**24  # bytes; an index of tensors has a few hundred thousand
_LIMITS = {
    "num_layers": 128,
    "num_attention_heads": 256,
    "attention_head_dim": 1024,
    "ffn_dim": 2**17,
    "base_dim": 4096,
}
_LONGEST = 256
M = TypeVar("M", bound=ConfigMixin)
N = TypeVar("N", bound=torch.nn.Module)
_STEMS = ("diffusion_pytorch_model", "model")


def config_of(folder: Path) -> dict[str, Any]:
    """What ``config.json`` of a model's folder says.

    Raises:
        InputError: There is none, or it is no JSON object.
    """
    return _document(Path(folder) / "config.json")


def weight_files(folder: Path) -> list[Path]:
    """The safetensors files of a model's folder: one, or those that its index names.

    Raises:
        InputError: There are none, or the index names one that is missing or lies elsewhere.
    """
    folder = Path(folder)
    for stem in _STEMS:
        if (index := folder / f"{stem}.safetensors.index.json").is_file():
            names = _document(index).get("weight_map")
            if not isinstance(names, dict) or not names:
                raise InputError(f"'{index}' has no weight_map; download it again")
            files = [folder / str(name) for name in sorted(set(map(str, names.values())))]
            for file in files:
                if file.parent != folder or not file.is_file():
                    raise InputError(f"'{index}' names '{file.name}', which is not there; download it again")
            return files
        if (single := folder / f"{stem}.safetensors").is_file():
            return [single]
    raise InputError(
        f"weights are safetensors files, there are none in '{folder}'; download the model in diffusers' layout"
    )


def tensor_shapes(folder: Path) -> dict[str, tuple[int, ...]]:
    """Names and shapes of a model's tensors, from the files' headers alone.

    Raises:
        InputError: A file is missing, cut short or no safetensors file.
    """
    shapes = {}
    for file in weight_files(folder):
        try:
            with safe_open(file, framework="numpy") as tensors:
                shapes |= {name: tuple(tensors.get_slice(name).get_shape()) for name in tensors.keys()}  # noqa: SIM118
        except (SafetensorError, OSError) as error:
            raise InputError(f"'{file}' is damaged or cut short ({error}); download it again") from None
    return shapes


def tensor_of(folder: Path, name: str) -> torch.Tensor:
    """One tensor of a model's folder whose files were checked; only it is read."""
    for file in weight_files(folder):
        with safe_open(file, framework="pt") as tensors:
            if name in tensors.keys():  # noqa: SIM118  (no mapping)
                return tensors.get_tensor(name)
    raise InputError(f"'{folder}' lacks the tensor {name}; download it again")


def skeleton(kind: type[M], config: Mapping[str, Any], folder: Path) -> M:
    """The model that a config describes, without weights: names, shapes and nothing else.

    Raises:
        InputError: The config of ``folder`` describes none, or one that cannot be meant.
    """
    for key, limit in _LIMITS.items():
        if key in config and not (isinstance(config[key], int) and 0 < config[key] <= limit):
            raise InputError(f"{key} of a model is 1 to {limit}, '{folder}' says {config[key]}; download it again")
    for key, value in config.items():
        if isinstance(value, list) and len(value) > _LONGEST:
            raise InputError(f"{key} of a model has at most {_LONGEST} entries, '{folder}' has {len(value)}")
    try:
        with torch.device("meta"):
            model = kind.from_config(dict(config))
    except (TypeError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"'{folder}/config.json' describes no {kind.__name__} ({error}); download it again") from None
    assert isinstance(model, kind)
    return model


def filled(kind: type[N], config: Mapping[str, Any], tensors: Mapping[str, torch.Tensor]) -> N:
    """The model that a config describes, with tensors that are shared, not copied; there must be all of them."""
    with torch.device("meta"):
        model = kind(**{key: value for key, value in config.items() if not key.startswith("_")})
    model.load_state_dict(dict(tensors), assign=True)
    return model


def require_tensors(folder: Path, expected: torch.nn.Module) -> None:
    """Raise `InputError` unless a model's folder holds every tensor of a skeleton, each of its shape."""
    found = tensor_shapes(folder)
    for name, tensor in expected.state_dict().items():
        shape = tuple(tensor.shape)
        if name not in found:
            raise InputError(f"'{folder}' lacks the tensor {name} {list(shape)}; download it again, or give another")
        if found[name] != shape:
            raise InputError(
                f"tensor {name} of '{folder}' is {list(found[name])} but its config.json says {list(shape)}; "
                "give a folder whose parts belong together"
            )


def _document(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise InputError(f"there is no '{file}'; give a model's folder in diffusers' layout")
    if file.stat().st_size > _MOST_JSON:
        raise InputError(f"'{file}' is larger than any description of a model; download it again")
    try:
        document = json.loads(file.read_text())
    except (ValueError, RecursionError) as error:
        raise InputError(f"'{file}' is not JSON ({error}); download it again") from None
    if not isinstance(document, dict):
        raise InputError(f"'{file}' is no JSON object; download it again")
    return document
