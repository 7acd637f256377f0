"""What a training told: lines of JSON, films of held-out clips, and curves where TensorBoard is installed."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dwgs.files import new_file
from dwgs.video import write_mp4
from generator.training.loop import Event, Saved

LOG_FILE = "log.jsonl"
FILMS = "validation"
"""Folder with a film for every look at the held-out clips."""


class Log:
    """Appends events to ``log.jsonl``, and films to ``validation/``.

    What an earlier run wrote after ``step``, and now happens again, is cut.
    """

    def __init__(self, folder: Path, step: int) -> None:
        self._folder = Path(folder)
        self._path = self._folder / LOG_FILE
        kept = [line for line in _lines(self._path) if json.loads(line)["step"] <= step]
        with new_file(self._path) as draft:
            draft.write_text("".join(line + "\n" for line in kept))
        self._curves = None
        if find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._curves = SummaryWriter(self._folder / "tensorboard", purge_step=step + 1)

    def write(self, event: Event) -> None:
        """Note an event; a checkpoint speaks for itself."""
        if isinstance(event, Saved):
            return
        kind = type(event).__name__.lower()
        values = {key: value for key, value in asdict(event).items() if key != "steps"}
        with self._path.open("a") as log:
            log.write(json.dumps({"event": kind, **values}) + "\n")
        if self._curves is not None:
            for key in values.keys() - {"step"}:
                self._curves.add_scalar(f"{kind}/{key}", values[key], event.step)

    def show(self, step: int, clips: Sequence[NDArray[np.uint8]]) -> None:
        """Write clips [T, H, W, 3], one below the other, as ``validation/00000500.mp4``."""
        if not clips:
            return
        film = np.concatenate(clips, 1)
        write_mp4(self._folder / FILMS / f"{step:08d}.mp4", film)
        if self._curves is not None:
            self._curves.add_image(FILMS, film[len(film) // 2], step, dataformats="HWC")


def _lines(path: Path) -> list[str]:
    """Whole lines; the last one of a killed run may be half a line."""
    if not path.is_file():
        return []
    return [line for line in path.read_text().split("\n")[:-1] if line.startswith("{") and line.endswith("}")]
