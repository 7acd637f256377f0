"""Where a fit keeps how far it is, so that it can be killed at any moment and go on."""

import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from dwgs.files import new_file

EVERY = 5.0
"""Seconds between two savings: what a killed fit loses at most."""


class Checkpoint:
    """A file with the state of one fit: tensors and numbers in dictionaries and lists.

    Args:
        path: Of the file.
        key: Of what is fitted and how; the state of anything else counts as none.
    """

    def __init__(self, path: Path, key: str) -> None:
        self._path, self._key = path, key
        self._saved = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """The state saved last; None where there is none, or none of this fit."""
        try:
            document = torch.load(self._path, weights_only=True)  # which runs nothing that a file might hold
        except (OSError, RuntimeError, EOFError, pickle.UnpicklingError):
            return None
        return document["state"] if isinstance(document, dict) and document.get("key") == self._key else None

    def offer(self, state: Callable[[], dict[str, Any]]) -> None:
        """Save the state, if it is time."""
        if time.monotonic() - self._saved >= EVERY:
            with new_file(self._path) as draft:
                torch.save({"key": self._key, "state": state()}, draft)
            self._saved = time.monotonic()

    def remove(self) -> None:
        """The fit is done."""
        self._path.unlink(missing_ok=True)
