"""What a training told: lines of JSON, and curves where TensorBoard is installed."""

import json
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from dwgs.files import new_file
from generator.training.loop import Event, Saved

LOG_FILE = "log.jsonl"


class Log:
    """Appends events to ``log.jsonl``; what an earlier run wrote after ``step``, and now happens again, is cut."""

    def __init__(self, folder: Path, step: int) -> None:
        self._path = Path(folder) / LOG_FILE
        kept = [line for line in _lines(self._path) if json.loads(line)["step"] <= step]
        with new_file(self._path) as draft:
            draft.write_text("".join(line + "\n" for line in kept))
        self._curves = None
        if find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._curves = SummaryWriter(Path(folder) / "tensorboard", purge_step=step + 1)

    def write(self, event: Event) -> None:
        """Note an event; a checkpoint speaks for itself."""
        if isinstance(event, Saved):
            return
        kind = type(event).__name__.lower()
        values = {key: value for key, value in asdict(event).items() if key != "steps"}
        with self._path.open("a") as log:
            log.write(json.dumps({"event": kind, **values}) + "\n")
        if self._curves is not None:
            for key, value in values.items():
                self._curves.add_scalar(f"{kind}/{key}", value, event.step)


def _lines(path: Path) -> list[str]:
    """Whole lines; the last one of a killed run may be half a line."""
    if not path.is_file():
        return []
    return [line for line in path.read_text().split("\n")[:-1] if line.startswith("{") and line.endswith("}")]
