"""The loop. Resumed or not, the same cache, config and seed give the same bytes."""

import json
import shutil
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from accelerate import Accelerator, DistributedDataParallelKwargs
from diffusers import WanVACETransformer3DModel
from diffusers.training_utils import EMAModel
from safetensors.torch import save_file

from dwgs.files import new_file, new_folder
from dwgs.scene.errors import InputError
from generator.training import checkpoint
from generator.training.cache import Cache
from generator.training.config import TrainingConfig
from generator.training.objective import Batch, Draw, loss_of
from generator.training.shards import share_out, whole
from generator.wan.adapter import PointAdapter, fingerprint_of, new_adapter
from generator.wan.folder import filled
from generator.wan.weights import PROMPT_FILE, Backbone

CHECKPOINTS = "checkpoints"
LOOKS = 32
"""Held-out clips that are looked at, at most, spread over all of them: looking takes time from learning."""
_HELD_OUT = 2**31
"""Draws for held-out clips have keys that no step has."""


@dataclass(frozen=True)
class Stepped:
    """A step of the optimiser is done."""

    step: int
    """Counted from 1."""
    steps: int
    loss: float
    rate: float


@dataclass(frozen=True)
class Validated:
    """Held-out clips were looked at, with the averaged weights."""

    step: int
    loss: float


@dataclass(frozen=True)
class Saved:
    """A checkpoint was written."""

    step: int
    path: Path


Event = Stepped | Validated | Saved


class Trainer:
    """One training: a backbone, an adapter, and where they stand.

    Args:
        cache: Encoded clips.
        backbone: What is steered.
        config: How.
        folder: For checkpoints; the newest one in it is taken up.
        sharded: Whether the processes share the network out, instead of each holding all of it.

    Raises:
        InputError: The folder holds another training, or the batch does not divide among the processes.
    """

    def __init__(
        self, cache: Cache, backbone: Backbone, config: TrainingConfig, folder: Path, sharded: bool = False
    ) -> None:
        self.cache, self.backbone, self.config, self.folder = cache, backbone, config, Path(folder)
        views = DistributedDataParallelKwargs(gradient_as_bucket_view=True)  # else there are two of each gradient
        self.accelerator = Accelerator(cpu=not torch.cuda.is_available(), kwargs_handlers=[views])
        processes = self.accelerator.num_processes
        require_processes(processes, config, sharded)
        self.teaching, held_out = cache.split()
        self.held_out = held_out[:: -(-len(held_out) // LOOKS) or 1]
        dtype = torch.bfloat16 if config.precision == "bf16" else torch.float32
        transformer = backbone.load_transformer(dtype)
        self.adapter = new_adapter(transformer, config.init, mask_time=config.mask_time, seed=config.seed)
        self.adapter.attach(transformer)
        if config.trains == "all":
            transformer.float().requires_grad_(True)
        transformer.enable_gradient_checkpointing()
        if sharded:
            share_out(transformer, self.accelerator.device, processes)
        self.transformer: WanVACETransformer3DModel = transformer.to(self.accelerator.device)
        self.text = backbone.load_text().prompt.to(self.accelerator.device, torch.float32)
        self.grey = cache.grey()
        self.parameters = {name: p for name, p in self.transformer.named_parameters() if p.requires_grad}
        self.optimizer = torch.optim.Adam(self.parameters.values(), lr=config.rate)
        self.average = EMAModel(self.parameters.values(), decay=config.ema)
        self.network = self.transformer if sharded else self.accelerator.prepare(self.transformer)
        self.step = self._take_up()

    def run(self) -> Generator[Event, None, None]:
        """Train to the end, telling how it goes."""
        config = self.config
        while self.step < config.steps:
            rate = config.rate_at(self.step)
            loss = self._step(rate)
            self.step += 1
            yield Stepped(self.step, config.steps, loss, rate)
            if self.step % config.checkpoint_every == 0 or self.step == config.steps:
                if self.held_out:
                    yield Validated(self.step, self.validate())
                yield Saved(self.step, self._save())

    def validate(self) -> float:
        """Mean loss over the held-out clips, each under the same noise every time."""
        config = replace(self.config, dropout=0.0)
        losses = []
        with self.averaged(), torch.no_grad():
            for number in self.held_out:
                losses.append(float(self._loss([number], [(_HELD_OUT, number)], config)))
        return float(np.mean(losses))

    @contextmanager
    def averaged(self) -> Iterator[None]:
        """The network with its averaged weights, while the block lasts."""
        self._exchange()
        try:
            yield
        finally:
            self._exchange()

    def clips_of_step(self, step: int) -> list[tuple[int, int]]:
        """(place in the batch, number of the clip) of this process's share: every clip once in each epoch."""
        batch, share = self.config.batch, self.config.batch // self.accelerator.num_processes
        first = self.accelerator.process_index * share
        chosen = []
        for place in range(first, first + share):
            epoch, at = divmod(step * batch + place, len(self.teaching))
            order = np.random.default_rng([self.config.seed, epoch]).permutation(len(self.teaching))
            chosen.append((place, self.teaching[order[at]]))
        return chosen

    def _step(self, rate: float) -> float:
        chosen = self.clips_of_step(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.zero_grad(set_to_none=True)
        starts = range(0, len(chosen), self.config.at_once)
        losses = []
        for start in starts:
            some = chosen[start : start + self.config.at_once]
            keys = [(self.step, place) for place, _ in some]
            between = self.accelerator.no_sync(self.network) if start != starts[-1] else nullcontext()
            with between:  # processes add up their gradients once
                loss = self._loss([number for _, number in some], keys, self.config) * (len(some) / len(chosen))
                self.accelerator.backward(loss)
            losses.append(loss.detach())
        self.optimizer.step()
        self.average.step(self.parameters.values())
        mean = self.accelerator.reduce(torch.stack(losses).sum(), "mean")
        assert isinstance(mean, torch.Tensor)
        return float(mean)

    def _loss(self, numbers: list[int], keys: list[tuple[int, int]], config: TrainingConfig) -> torch.Tensor:
        samples = [self.cache[number] for number in numbers]
        draws = [Draw.of(sample, config, key) for sample, key in zip(samples, keys, strict=True)]
        batch = Batch.of(samples, draws, self.grey, config.mask_time)
        with self.arithmetic():
            return loss_of(self.network, batch, self.text)

    def arithmetic(self) -> torch.autocast:
        """A block in which the network reckons as it is trained to."""
        device, is_bf16 = self.accelerator.device.type, self.config.precision == "bf16"
        # without autocast's cache: it keeps a second copy of every weight, though each is used once
        return torch.autocast(device, torch.bfloat16, enabled=is_bf16, cache_enabled=False)

    def export(self, folder: Path) -> tuple[Path, Path]:
        """Write the averaged ``adapter/`` and, where it learnt, too, the backbone; gives the folders of both.

        All processes must call; the main one writes.
        """
        place, steered = folder / checkpoint.ADAPTER_FOLDER, self.backbone.folder
        average = self._whole_average()
        if self.config.trains == "all":
            steered = folder / "trained-backbone"
        if self.accelerator.is_main_process:
            adapter = self._adapter(average)
            if self.config.trains == "all":
                with new_folder(steered) as draft:
                    shutil.copytree(self.backbone.folder / "vae", draft / "vae")
                    shutil.copy(self.backbone.folder / PROMPT_FILE, draft / PROMPT_FILE)
                    filled(WanVACETransformer3DModel, self.transformer.config, average).save_pretrained(
                        draft / "transformer"
                    )
                adapter.register_to_config(fingerprint=fingerprint_of(average["scale_shift_table"]))
            adapter.save(place)
        self.accelerator.wait_for_everyone()
        return steered, place

    def _exchange(self) -> None:
        """Weights and average change places."""
        with torch.no_grad():
            for parameter, average in zip(self.parameters.values(), self.average.shadow_params, strict=True):
                learnt = parameter.clone()
                parameter.copy_(average)
                average.copy_(learnt)

    def _whole_average(self) -> dict[str, torch.Tensor]:
        """The averaged weights by name, in the main process's host memory; all processes must ask."""
        tensors = {}
        for name, average in self._state.average.items():
            tensor = whole(average)
            if self.accelerator.is_main_process:
                tensors[name] = tensor.cpu()
        return tensors

    def _adapter(self, weights: Mapping[str, torch.Tensor]) -> PointAdapter:
        """An adapter of whole weights, named as in the transformer it is attached to."""
        own = {name.removeprefix("vace_"): w for name, w in weights.items() if name.startswith("vace_")}
        return filled(PointAdapter, self.adapter.config, own)

    @property
    def _state(self) -> checkpoint.State:
        average = dict(zip(self.parameters, self.average.shadow_params, strict=True))
        return checkpoint.State(self.parameters, average, self.optimizer)

    def _take_up(self) -> int:
        """Go on from the newest checkpoint; gives the steps that are done."""
        said = json.loads(json.dumps(_identity(self.config, self.cache)))
        file = self.folder / "training.json"
        if file.is_file():
            found = json.loads(file.read_text())
            for key, value in said.items():
                if found.get(key) != value:
                    raise InputError(
                        f"'{self.folder}' holds a training with {key} {found.get(key)}, not {value}; "
                        "train into another folder, or with the same settings"
                    )
        elif self.accelerator.is_main_process:
            with new_file(file) as draft:
                draft.write_text(json.dumps(said, indent=2))
        path = checkpoint.newest(self.folder / CHECKPOINTS)
        self.accelerator.wait_for_everyone()
        if path is None:
            return 0
        step = checkpoint.read(path, self._state)
        self.average.optimization_step = step
        return step

    def _save(self) -> Path:
        path = self.folder / CHECKPOINTS / checkpoint.name_of(self.step)
        tensors = {}
        for name, tensor in self._state.tensors():  # in every process, for each may hold a part of it
            if self.accelerator.is_main_process:
                tensors[name] = tensor.cpu().contiguous()
        if self.accelerator.is_main_process:
            average = {name: tensors[f"average:{name}"] for name in self.parameters}
            with new_folder(path) as draft:
                save_file(tensors, draft / checkpoint.STATE_FILE)
                self._adapter(average).save(draft / checkpoint.ADAPTER_FOLDER)
            checkpoint.prune(path.parent, self.config.keep)
        self.accelerator.wait_for_everyone()
        return path


def require_processes(processes: int, config: TrainingConfig, sharded: bool) -> None:
    """Raise `InputError` unless so many processes can train so."""
    if config.batch % processes:
        raise InputError(
            f"a batch divides among the processes, {config.batch} clips among {processes} do not; choose a --batch"
        )
    if sharded and processes == 1:
        raise InputError(
            "a network is shared out among several processes, there is one; launch with torchrun --nproc_per_node 8, "
            "or leave --shard out"
        )


def _identity(config: TrainingConfig, cache: Cache) -> dict:
    """What a training cannot change on its way."""
    settings = asdict(config)
    for free in ("steps", "checkpoint_every", "keep"):
        del settings[free]
    return {**settings, "clips": len(cache), "shape": list(cache.shape)}
