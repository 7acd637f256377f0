"""Starts Warp without a word: standard output and standard error belong to the programs."""

import os
from functools import cache

import warp as wp


@cache
def start_warp() -> None:
    """Initialise Warp once; only errors are printed from here on.

    Where no NVIDIA driver is installed, Warp's native code says so on the standard error of every process
    that starts it, and no setting silences that: the descriptor is turned away while it starts.
    """
    wp.config.log_level = wp.LOG_ERROR
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
