"""Latents of training clips, encoded once: tar shards of safetensors, which any tool can open.

A shard holds ``00000012.safetensors`` and ``00000012.json`` for each clip. Masks are kept as bits at full size, so
that the rule by which they become latent masks is chosen in training.
"""

import io
import json
import tarfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from dwgs.files import new_file
from dwgs.formats.document import read_document, write_document
from dwgs.scene.errors import InputError
from generator.training.clips import TrainingClip
from generator.training.config import ClipConfig
from generator.wan.clip import Clip
from generator.wan.encode import Codec, ControlLatents, pack_mask
from generator.wan.settings import MaskTime

INDEX_STAMP = {"format": "dwgs latent cache", "format_version": 1}
SHARD = 64
"""Clips in a shard."""
GAIN, NOISE = 0.03, 2.0
"""Given frames are those of the codec's round trip, up to 3 % brighter or darker in each channel, with noise of two
grey levels: in use, a network makes them."""


@dataclass(frozen=True)
class Sample:
    """A clip as latents [1, z, T', h, w] and masks [T, H, W]."""

    name: str
    stride: int
    target: Tensor
    """The recording."""
    inactive: Tensor
    """The recording without the vehicle's region."""
    points: Tensor
    """The vehicle's points."""
    given_points: Tensor
    """The same with given frames."""
    reactive_mask: NDArray[np.bool_]
    point_mask: NDArray[np.bool_]
    given_mask: NDArray[np.bool_]

    def control(self, aware: bool, mask_time: MaskTime) -> ControlLatents:
        """What the network is told: points alone, or with given frames."""
        return ControlLatents(
            self.inactive,
            self.given_points if aware else self.points,
            pack_mask(self.reactive_mask, mask_time),
            pack_mask(self.given_mask if aware else self.point_mask, mask_time),
        )


_LATENTS = ("target", "inactive", "points", "given_points")
_MASKS = ("reactive_mask", "point_mask", "given_mask")


def encode(clip: TrainingClip, codec: Codec, config: ClipConfig) -> Sample:
    """The latents of a clip."""
    recorded = Clip.of(clip.frames)
    everything = np.ones(recorded.reactive_mask.shape, bool)
    target = codec.encode(recorded.video, everything)
    decoded = codec.decode(target)
    seed = [config.seed, *clip.name.encode()]
    rng = np.random.default_rng(seed)
    gain = 1 + GAIN * rng.uniform(-1, 1, 3)
    images = {}
    for at in config.given:
        noisy = gain * decoded[at] + rng.normal(0, NOISE, decoded[at].shape)
        images[at] = np.rint(np.clip(noisy, 0, 255)).astype(np.uint8)
    given = recorded.given(images)
    plain, aware = (ControlLatents.of(c, codec, "group") for c in (recorded, given))
    return Sample(
        clip.name,
        clip.stride,
        target,
        plain.inactive,
        plain.points,
        aware.points,
        recorded.reactive_mask,
        recorded.point_mask,
        given.point_mask,
    )


def write_cache(
    clips: Iterable[TrainingClip],
    codec: Codec,
    config: ClipConfig,
    folder: Path,
    on_clip: Callable[[int], None] | None = None,
) -> None:
    """Fill a folder with shards, the latents of grey, and an index.

    Raises:
        InputError: There is no clip, or clips differ in size.
    """
    entries: list[dict[str, Any]] = []
    shape: tuple[int, ...] | None = None
    shard: list[Sample] = []
    for clip in clips:
        sample = encode(clip, codec, config)
        shape = shape or sample.reactive_mask.shape
        if sample.reactive_mask.shape != shape:
            raise InputError(
                f"clips of one training are alike, {sample.name} is {sample.reactive_mask.shape}, not {shape}; "
                "give every drive the same --size"
            )
        entries.append({"name": sample.name, "stride": sample.stride})
        shard.append(sample)
        if len(shard) == SHARD:
            _write_shard(shard, len(entries) - len(shard), folder)
            shard = []
        if on_clip:
            on_clip(len(entries))
    if shape is None:
        raise InputError(
            f"training takes clips of {config.frames} frames that show a vehicle the LiDAR hit, there are none; "
            "give longer drives, with tracks and sweeps"
        )
    if shard:
        _write_shard(shard, len(entries) - len(shard), folder)
    (folder / "grey.safetensors").write_bytes(save({"grey": codec.encode_grey(shape).to(torch.bfloat16)}))
    write_document({"shape": list(shape), "clips": entries}, INDEX_STAMP, folder / "index.json")


class Cache:
    """Samples of a folder of `write_cache`, each read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        document = read_document(INDEX_STAMP, self.folder / "index.json")
        try:
            self.shape = tuple(int(side) for side in document["shape"])
            self.names = [str(clip["name"]) for clip in document["clips"]]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"'{self.folder / 'index.json'}' lacks or garbles {error}; encode the clips again"
            ) from None
        self._places = self._index()

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, number: int) -> Sample:
        """One clip; raises `InputError` where its shard is damaged."""
        file, offset, size = self._places[f"{number:08d}.safetensors"]
        with file.open("rb") as shard:
            shard.seek(offset)
            data = shard.read(size)
        try:
            tensors = load(data)
            target, inactive, points, given = (tensors[name].float() for name in _LATENTS)
            masks = [_unpacked(tensors[name], self.shape) for name in _MASKS]
            stride = int(tensors["stride"])
        except (SafetensorError, KeyError, ValueError) as error:
            raise InputError(f"clip {number} of '{file}' is damaged ({error}); encode the clips again") from None
        return Sample(self.names[number], stride, target, inactive, points, given, *masks)

    def grey(self) -> Tensor:
        """Latents of a clip without anything in it."""
        return load((self.folder / "grey.safetensors").read_bytes())["grey"].float()

    def split(self) -> tuple[list[int], list[int]]:
        """Numbers of clips that teach, and of those held out: every eighth vehicle, whole."""
        vehicles = list(dict.fromkeys(vehicle_of(name) for name in self.names))
        held = set(vehicles[7::8])
        numbers = range(len(self))
        return [i for i in numbers if vehicle_of(self.names[i]) not in held], [
            i for i in numbers if vehicle_of(self.names[i]) in held
        ]

    def _index(self) -> dict[str, tuple[Path, int, int]]:
        places = {}
        for file in sorted(self.folder.glob("*.tar")):
            try:
                with tarfile.open(file) as shard:
                    places |= {m.name: (file, m.offset_data, m.size) for m in shard}
            except tarfile.TarError as error:
                raise InputError(f"'{file}' is damaged ({error}); encode the clips again") from None
        missing = [i for i in range(len(self)) if f"{i:08d}.safetensors" not in places]
        if missing:
            raise InputError(f"'{self.folder}' lacks clip {missing[0]} of {len(self)}; encode the clips again")
        return places


def _write_shard(samples: list[Sample], first: int, folder: Path) -> None:
    with new_file(folder / f"{first:08d}.tar") as draft, tarfile.open(draft, "w") as shard:
        for number, sample in enumerate(samples, first):
            tensors = {name: getattr(sample, name).to(torch.bfloat16).contiguous() for name in _LATENTS}
            tensors |= {name: _packed(getattr(sample, name)) for name in _MASKS}
            tensors["stride"] = torch.tensor(sample.stride)
            _add(shard, f"{number:08d}.safetensors", save(tensors))
            _add(shard, f"{number:08d}.json", json.dumps({"name": sample.name, "stride": sample.stride}).encode())


def _add(shard: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    shard.addfile(entry, io.BytesIO(data))


def _packed(mask: NDArray[np.bool_]) -> Tensor:
    return torch.from_numpy(np.packbits(mask))


def _unpacked(bits: Tensor, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.unpackbits(bits.numpy(), count=int(np.prod(shape))).astype(bool).reshape(shape)


def vehicle_of(name: str) -> str:
    """The drive and vehicle that a clip of that name shows."""
    return name.rpartition("/")[0]
