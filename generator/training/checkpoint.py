"""Where a training stands, in safetensors: what is learnt, its average, and Adam's moments; the frozen rest is not."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.optim import Adam

from dwgs.scene.errors import InputError

STATE_FILE = "state.safetensors"
ADAPTER_FOLDER = "adapter"
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class State:
    """The learnt parameters by name, their average, and the optimiser that moves them."""

    parameters: Mapping[str, torch.nn.Parameter]
    average: Mapping[str, Tensor]
    optimizer: Adam

    def write(self, path: Path) -> None:
        """Write all of it to a file."""
        save_file(self.tensors(), path)

    def tensors(self) -> dict[str, Tensor]:
        """All of it, by name; on a CPU these are views of what goes on changing."""
        tensors = {f"weight:{name}": p.detach() for name, p in self.parameters.items()}
        tensors |= {f"average:{name}": average for name, average in self.average.items()}
        for name, parameter in self.parameters.items():
            moments = self.optimizer.state[parameter]
            tensors |= {f"{moment}:{name}": moments[moment] for moment in _MOMENTS}
        return {name: tensor.cpu().contiguous() for name, tensor in tensors.items()}

    def restore(self, tensors: Mapping[str, Tensor]) -> None:
        """Take up what `tensors` gave; raises KeyError where something is missing."""
        with torch.no_grad():
            for name, parameter in self.parameters.items():
                parameter.copy_(tensors[f"weight:{name}"])
                self.average[name].copy_(tensors[f"average:{name}"])
                moments = {moment: tensors[f"{moment}:{name}"].clone() for moment in _MOMENTS}
                on_device = {k: v if k == "step" else v.to(parameter.device) for k, v in moments.items()}
                self.optimizer.state[parameter] = on_device


def newest(folder: Path) -> Path | None:
    """The checkpoint with the most steps, or None."""
    found = sorted(path for path in Path(folder).glob("[0-9]*") if path.is_dir())
    return found[-1] if found else None


def read(path: Path, state: State) -> int:
    """Restore a checkpoint; gives the steps that are done.

    Raises:
        InputError: It is damaged, or of another training.
    """
    try:
        state.restore(load_file(path / STATE_FILE))
        return int(path.name)
    except (OSError, SafetensorError, KeyError, RuntimeError, ValueError) as error:
        raise InputError(f"checkpoint '{path}' is damaged or of another training ({error}); delete it") from None


def name_of(step: int) -> str:
    """Of a checkpoint's folder."""
    return f"{step:08d}"


def prune(folder: Path, keep: int) -> None:
    """Drop all but the newest few."""
    for old in sorted(path for path in folder.glob("[0-9]*") if path.is_dir())[:-keep]:
        shutil.rmtree(old)
