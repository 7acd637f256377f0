"""Networks that judge pictures, from files that the user supplies: nothing is downloaded, nothing substituted.

Each is one TorchScript file, and what a file must be is what the published ones are:

- FID: images [N, 3, H, W] in [0, 255] to features [N, D] (Inception of StyleGAN2-ADA and its like);
- FVD: clips [N, 3, T, H, W] in [0, 255] to features [N, D] (the I3D of StyleGAN-V and its like);
- LPIPS: two lots of images [N, 3, H, W] in [-1, 1] to distances [N] (``lpips.LPIPS``, traced).

Switches that the published files have (``return_features``, ``rescale``, ``resize``) are set where they exist.
"""

import hashlib
import io
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from dwgs.scene.errors import InputError

BATCH = 8
"""Images that go through a network at once."""
CLIP_FRAMES, CLIP_STRIDE = 16, 8
"""FVD looks at clips of so many frames, so many frames apart. The usual length; the paper names none."""

_SWITCHES = ("return_features", "rescale", "resize")


@dataclass(frozen=True)
class NetworkFile:
    """A TorchScript file, and the hash that says which."""

    path: Path
    sha256: str
    """Lower-case hexadecimal."""

    @staticmethod
    def parse(text: str) -> "NetworkFile":
        """Of ``FILE:SHA256``; `InputError` where no hash is stated or the file is not there."""
        match = re.fullmatch(r"(.+):([0-9a-fA-F]{64})", text)
        if match is None:
            raise InputError(
                f"'{text}' states no hash: a TorchScript file is a program that runs when it is loaded, so only one "
                "whose SHA-256 you state is; write FILE:SHA256 with the hash that its publisher gives"
            )
        path = Path(match[1])
        if not path.is_file():
            raise InputError(f"there is no network '{path}'; give the TorchScript file, or leave its metric out")
        return NetworkFile(path, match[2].lower())


class Network:
    """A network that is loaded, on the GPU where there is one."""

    def __init__(self, file: NetworkFile) -> None:
        """Load ``file``; `InputError` where its hash is another than stated, or it is no TorchScript."""
        content = file.path.read_bytes()
        found = hashlib.sha256(content).hexdigest()
        if found != file.sha256:
            raise InputError(
                f"'{file.path}' has SHA-256 {found}, not {file.sha256} as stated; it is not loaded, for a TorchScript "
                "file runs code: get the file again, or state the hash of the one that you trust"
            )
        self._device = "cuda" if torch.cuda.is_available() else "cpu"
        self._path = file.path
        try:
            with warnings.catch_warnings():  # torch would rather have another format, but these networks come in this
                warnings.simplefilter("ignore", DeprecationWarning)
                module = torch.jit.load(io.BytesIO(content), map_location=self._device)
        except RuntimeError as error:
            raise InputError(f"'{file.path}' is not TorchScript ({_first_line(error)}); export it again") from None
        self._module = module.eval()
        known = {argument.name for argument in module.forward.schema.arguments}
        self._switches = {name: True for name in _SWITCHES if name in known}

    def image_features(self, images: Iterable[NDArray[np.uint8]]) -> NDArray[np.float32]:
        """Features [N, D] of N images [H, W, 3]."""
        lots = (_planes(lot) for lot in _batched(images, BATCH))
        return self._features([self._run(lot) for lot in lots], "images")

    def clip_features(self, images: Iterable[NDArray[np.uint8]]) -> NDArray[np.float32]:
        """Features [N, D] of the N clips of `CLIP_FRAMES` in a video of images [H, W, 3]; N is 0 for a shorter one."""
        window: list[NDArray[np.uint8]] = []
        outputs = []
        for image in images:
            window.append(image)
            if len(window) == CLIP_FRAMES:
                outputs.append(self._run(_planes(window).transpose(0, 1)[None]))
                del window[:CLIP_STRIDE]
        return self._features(outputs, "clips")

    def mean_distance(self, images: Iterable[NDArray[np.uint8]], references: Iterable[NDArray[np.uint8]]) -> float:
        """Mean distance of images [H, W, 3] from their references."""
        pairs = zip(_batched(images, BATCH), _batched(references, BATCH), strict=True)
        lots = [self._run(*(_planes(lot) / 127.5 - 1 for lot in pair)).reshape(-1) for pair in pairs]
        return float(self._finite(torch.cat(lots)).mean())

    def _run(self, *inputs: Tensor) -> Tensor:
        try:
            with torch.no_grad():
                output: Any = self._module(*(x.to(self._device) for x in inputs), **self._switches)
        except RuntimeError as error:
            shapes = " and ".join(str(tuple(x.shape)) for x in inputs)
            raise InputError(f"'{self._path}' does not take {shapes}: {_first_line(error)}") from None
        if not isinstance(output, Tensor) or output.shape[:1] != inputs[0].shape[:1]:
            raise InputError(f"'{self._path}' gives no tensor with one row for each input; it is another network")
        return output.float().cpu()

    def _features(self, outputs: list[Tensor], of: str) -> NDArray[np.float32]:
        if not outputs:
            return np.zeros((0, 0), np.float32)
        if any(output.ndim != 2 for output in outputs):
            raise InputError(f"'{self._path}' gives {tuple(outputs[0].shape)} for {of}, not one vector for each")
        return self._finite(torch.cat(outputs)).numpy()

    def _finite(self, output: Tensor) -> Tensor:
        if not output.isfinite().all():
            raise InputError(f"'{self._path}' gives numbers that are not finite; it is damaged, or another network")
        return output


def _batched(items: Iterable[NDArray[np.uint8]], count: int) -> Iterator[list[NDArray[np.uint8]]]:
    items = iter(items)
    while lot := list(islice(items, count)):
        yield lot


def _planes(images: list[NDArray[np.uint8]]) -> Tensor:
    """[N, 3, H, W] in [0, 255] of N images [H, W, 3]."""
    return torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float()


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1][:200] if lines else type(error).__name__
