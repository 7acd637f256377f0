"""Where a training stands, in safetensors: what is learnt, its average, and Adam's moments; the frozen rest is not.

A file holds whole tensors: any number of processes, sharing the network out or not, goes on from it.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor
from torch.optim import Adam

from dwgs.scene.errors import InputError
from generator.training.shards import part_of, whole

STATE_FILE = "state.safetensors"
ADAPTER_FOLDER = "adapter"
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


@dataclass(frozen=True)
class State:
    """The learnt parameters by name, their average, and the optimiser that moves them."""

    parameters: Mapping[str, torch.nn.Parameter]
    average: Mapping[str, Tensor]
    optimizer: Adam

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """All of it by name, one whole tensor after another; all processes must ask.

        On a CPU they may be views of what goes on changing.
        """
        for name, parameter in self.parameters.items():
            moments = self.optimizer.state[parameter]
            yield f"weight:{name}", whole(parameter.detach())
            yield f"average:{name}", whole(self.average[name])
            for moment in _MOMENTS:
                yield f"{moment}:{name}", whole(moments[moment])

    def restore(self, tensor_of: Callable[[str], Tensor]) -> None:
        """Take up what `tensors` gave, asking for one after another."""
        with torch.no_grad():
            for name, parameter in self.parameters.items():
                parameter.copy_(part_of(tensor_of(f"weight:{name}"), parameter))
                self.average[name].copy_(part_of(tensor_of(f"average:{name}"), parameter))
                moments = {"step": tensor_of(f"step:{name}").clone()}  # Adam counts in host memory
                for moment in ("exp_avg", "exp_avg_sq"):
                    part = part_of(tensor_of(f"{moment}:{name}"), parameter)
                    moments[moment] = torch.empty_like(parameter).copy_(part)
                self.optimizer.state[parameter] = moments


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
        with safe_open(path / STATE_FILE, framework="pt") as file:
            state.restore(file.get_tensor)
        return int(path.name)
    except (OSError, SafetensorError, RuntimeError, ValueError) as error:
        raise InputError(f"checkpoint '{path}' is damaged or of another training ({error}); delete it") from None


def name_of(step: int) -> str:
    """Of a checkpoint's folder."""
    return f"{step:08d}"


def prune(folder: Path, keep: int) -> None:
    """Drop all but the newest few."""
    for old in sorted(path for path in folder.glob("[0-9]*") if path.is_dir())[:-keep]:
        shutil.rmtree(old)
