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
        path: Of the file; another for whatever is fitted to something else, or in another way.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._saved = path, time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """The state saved last; None where there is none that can be read."""
        try:
            return torch.load(self._path, weights_only=True)  # which runs nothing that a file might hold
        except (OSError, RuntimeError, EOFError, pickle.UnpicklingError):
            return None

    def offer(self, state: Callable[[], dict[str, Any]]) -> None:
        """Save the state, if it is time."""
        if time.monotonic() - self._saved >= EVERY:
            with new_file(self._path) as draft:
                torch.save(state(), draft)
            self._saved = time.monotonic()
