"""The backends ``wan`` (Wan2.1-VACE with a PointAdapter: DriveWeaver) and ``vace`` (Wan2.1-VACE as it is published)."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Queue
from threading import Lock

import numpy as np
import torch
from numpy.typing import NDArray

from dwgs.scene.errors import InputError
from dwgs.scene.scene import Frame, Scene
from dwgs.video import LosslessVideo, write_lossless
from generator.conditions.conditions import ConditionFrame, Conditions
from generator.conditions.whole_frame import require_lidar, whole_frame
from generator.generator import Capabilities
from generator.long_video import CLIP, Pass, plan, seen
from generator.wan.adapter import adapter_config, fingerprint_of, load_adapter, parameters_of, require_adapter
from generator.wan.clip import Clip
from generator.wan.folder import tensor_of
from generator.wan.lora import fuse, require_lora
from generator.wan.memory import GB, TILE, Footprint, MemoryPlan, Weights, plan_memory, table
from generator.wan.network import Network, place, require_attention
from generator.wan.settings import WanSettings
from generator.wan.weights import Backbone

SIZE_MULTIPLE = 16
"""Of the codec and the transformer's patches together [px]."""


class WanGenerator:
    """Paints a vehicle into recorded frames by denoising them, guided by its points.

    Args:
        settings: Folders, sampling, devices. The folders are checked now, and loaded when work begins.
        parts: Folder where finished clips are kept, so that a run of the same settings, conditions and seed that was
            killed goes on where it was.

    Raises:
        InputError: A folder is incomplete or does not fit the other, or a device is not there.
    """

    def __init__(self, settings: WanSettings, parts: Path | None = None) -> None:
        self.settings = settings
        self.parts = parts
        self.backbone = Backbone.open(settings.backbone)
        if settings.adapter is not None:
            table = tensor_of(settings.backbone / "transformer", "scale_shift_table")
            require_adapter(settings.adapter, self.backbone.skeleton.config, fingerprint_of(table))
        self.devices = settings.devices or ("cuda" if torch.cuda.is_available() else "cpu",)
        for device in self.devices:
            _require_device(device)
            if settings.attention is not None:
                require_attention(settings.attention, device)
        self._changed = [require_lora(lora, self.backbone.skeleton) for lora in settings.loras]

    @property
    def name(self) -> str:
        """``wan`` with an adapter, ``vace`` without."""
        return "vace" if self.settings.adapter is None else "wan"

    @property
    def capabilities(self) -> Capabilities:
        """What it needs and promises."""
        kind = self.devices[0].partition(":")[0]
        return Capabilities(None, SIZE_MULTIPLE, kind, needs_weights=True, deterministic=kind == "cpu")

    def check(self, scene: Scene) -> list[str]:
        """How its weights will fit; see `generator.generator.Generator.check`."""
        for height, width in _sizes(scene):
            if width % SIZE_MULTIPLE or height % SIZE_MULTIPLE:
                raise InputError(
                    f"'{self.name}' takes images whose sides are multiples of {SIZE_MULTIPLE}, these are "
                    f"{width}x{height}; choose a --size such as {_near(width)}x{_near(height)}"
                )
        if self.settings.whole_frame:
            require_lidar(scene)
        if self.settings.tiled and max(map(max, _sizes(scene))) <= TILE:
            raise InputError(f"no image here has a side of more than a tile's {TILE} px; leave --tiles out")
        footprint, memory = self._memory(scene)
        notes = [f"{self.name}: {footprint.weights / GB:.1f} GB of weights, clips of {CLIP} frames; what fits where:"]
        notes += [*table(footprint), f"on {', '.join(self.devices)}: {memory}"]
        for lora, changed in zip(self.settings.loras, self._changed, strict=True):
            notes.append(f"'{lora.path.name}' at strength {lora.strength:g} changes the backbone in {changed} places")
        sampling = self.settings.sampling
        notes.append(f"{sampling.steps} steps are {sampling.evaluations} runs of the network for each clip")
        return notes

    def generate(
        self, conditions: Conditions, seed: int, on_progress: Callable[[int, int], None] | None = None
    ) -> Scene:
        """The recorded scene with the vehicle in it; progress counts steps of all passes through the network.

        The frames' reactive masks say where the vehicle may show, even where whole images are new.
        """
        told = whole_frame(conditions) if self.settings.whole_frame else conditions
        films = {name: plan(self.settings.strategy, len(frames)) for name, frames in conditions.frames.items()}
        passes = sum(len(level) for levels in films.values() for level in levels)
        counter = _Counter(passes * self.settings.sampling.steps, on_progress)
        studio = _Studio(self, conditions.scene, counter)
        edited = {}
        for number, (name, frames) in enumerate(told.frames.items()):
            made: dict[int, NDArray[np.uint8]] = {}
            for depth, level in enumerate(films[name]):
                jobs = [_Job(f"{name}-{depth}-{i}", a_pass, (seed, number, depth, i)) for i, a_pass in enumerate(level)]
                fresh: dict[int, NDArray[np.uint8]] = {}
                for job, images in zip(jobs, studio.work(jobs, frames, made), strict=True):
                    fresh |= zip(job.a_pass.makes, images[job.a_pass.drops :], strict=True)
                made |= fresh
            edited[name] = tuple(_edited(f, made[i]) for i, f in enumerate(conditions.frames[name]))
        return replace(conditions.scene, frames=edited)

    def load(self, device: str, memory: MemoryPlan) -> Network:
        """Everything, on one device."""
        settings = self.settings
        dtype = torch.float32 if device == "cpu" else torch.bfloat16
        transformer = self.backbone.load_transformer(dtype)
        mask_time = "vace"
        if settings.adapter is not None:
            adapter = load_adapter(settings.adapter, transformer, dtype)
            adapter.attach(transformer)
            mask_time = adapter.mask_time
        for lora in settings.loras:  # after the adapter, which knows the backbone by its weights
            fuse(lora, transformer)
        transformer.requires_grad_(False)
        place(transformer, device, memory, settings.attention)
        codec = self.backbone.load_codec(device, dtype)
        if settings.tiled:
            codec.work_in_tiles()
        return Network(transformer, codec, self.backbone.load_text(), mask_time, settings.adapter is not None)

    def _memory(self, scene: Scene) -> tuple[Footprint, MemoryPlan]:
        """What is needed for the largest camera's clips, and how the smallest device is used."""
        whole, own = self.backbone.parameters
        adapter = self.settings.adapter
        branch = own if adapter is None else parameters_of(adapter_config(adapter), adapter)
        height, width = max(_sizes(scene), key=lambda size: size[0] * size[1])
        longest = max(
            len(a_pass.frames)
            for frames in scene.frames.values()
            for level in plan(self.settings.strategy, len(frames))
            for a_pass in level
        )
        on_cpu = "cpu" in self.devices
        footprint = Footprint.of(
            self.backbone.config,
            whole - own,
            branch,
            (longest, height, width),
            4 if on_cpu else 2,
            self.settings.tiled,
        )
        choices: tuple[Weights, ...] = ("resident",) if on_cpu else ("resident", "streamed")
        if self.settings.weights is not None:
            choices = (self.settings.weights,)
        return footprint, plan_memory(footprint, min(map(_capacity, self.devices)), choices)


@dataclass(frozen=True)
class _Job:
    """A pass, the name of its file, and the seed of its noise."""

    name: str
    a_pass: Pass
    seed: tuple[int, ...]


class _Studio:
    """Networks, loaded when the first clip asks for them, and the clips that are finished."""

    def __init__(self, generator: WanGenerator, scene: Scene, counter: "_Counter") -> None:
        self._generator, self._counter = generator, counter
        self._memory = generator._memory(scene)[1]
        self._free: Queue[Network] = Queue()
        self._loaded = False

    def work(
        self, jobs: list[_Job], frames: tuple[ConditionFrame, ...], made: dict[int, NDArray[np.uint8]]
    ) -> list[NDArray[np.uint8]]:
        """Images [T, H, W, 3] of each job; jobs whose files are there are done already."""
        if not self._loaded and any(self._kept(job) is None for job in jobs):
            for device in self._generator.devices:
                self._free.put(self._generator.load(device, self._memory))
            self._loaded = True
        with ThreadPoolExecutor(len(self._generator.devices)) as pool:
            return list(pool.map(lambda job: self._do(job, frames, made), jobs))

    def _do(
        self, job: _Job, frames: tuple[ConditionFrame, ...], made: dict[int, NDArray[np.uint8]]
    ) -> NDArray[np.uint8]:
        sampling = self._generator.settings.sampling
        file = self._kept(job)
        if file is not None:
            self._counter.add(sampling.steps)
            video = LosslessVideo(file)
            return np.stack([video[i] for i in range(len(video))])
        clip = Clip.of([frames[i] for i in seen(job.a_pass.frames, len(frames))])
        clip = clip.given({at: made[job.a_pass.frames[at]] for at in job.a_pass.given})
        sampling = replace(sampling, batched=sampling.batched and self._memory.batched)
        noise = int(np.random.SeedSequence(job.seed).generate_state(1, np.uint32)[0])
        network = self._free.get()
        try:
            images = network.generate(clip, sampling, noise, lambda _: self._counter.add(1))
        except (RuntimeError, MemoryError) as error:
            if not _is_out_of_memory(error):
                raise
            raise InputError(
                "the device ran out of memory, more than was planned; finished clips are kept: run it again with "
                "--weights streamed, or with a smaller --size"
            ) from None
        finally:
            self._free.put(network)
        if self._generator.parts is not None:
            write_lossless(self._generator.parts / f"{job.name}.avi", images)
        return images

    def _kept(self, job: _Job) -> Path | None:
        """The file of a finished job."""
        parts = self._generator.parts
        file = None if parts is None else parts / f"{job.name}.avi"
        return file if file is not None and file.is_file() else None


class _Counter:
    """Counts what several threads do."""

    def __init__(self, total: int, on_progress: Callable[[int, int], None] | None) -> None:
        self._done, self._total, self._on_progress = 0, total, on_progress
        self._lock = Lock()

    def add(self, steps: int) -> None:
        with self._lock:
            self._done += steps
            if self._on_progress:
                self._on_progress(self._done, self._total)


def _edited(condition: ConditionFrame, image: NDArray[np.uint8]) -> Frame:
    return replace(condition.frame, load_pixels=lambda: image.copy(), load_reactive_mask=condition.load_reactive_mask)


def _require_device(device: str) -> None:
    """Raise `InputError` unless PyTorch can work there."""
    try:
        torch.empty(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"there is no device '{device}' here ({reason}); give --device cpu, cuda or cuda:1") from None


def _capacity(device: str) -> float:
    """Memory that is free [bytes]."""
    if device.startswith("cuda"):
        return float(torch.cuda.mem_get_info(device)[0])
    import psutil

    return float(psutil.virtual_memory().available)


def _is_out_of_memory(error: Exception) -> bool:
    """On a GPU it has a type of its own; on a CPU only the words tell."""
    return isinstance(error, torch.OutOfMemoryError | MemoryError) or "can't allocate memory" in str(error)


def _sizes(scene: Scene) -> list[tuple[int, int]]:
    """(height, width) of each camera's images."""
    return [(frames[0].camera.height, frames[0].camera.width) for frames in scene.frames.values()]


def _near(side: int) -> int:
    return max(SIZE_MULTIPLE, round(side / SIZE_MULTIPLE) * SIZE_MULTIPLE)
