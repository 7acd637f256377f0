"""Warp kernels, one pass per file; they know arrays, not tensors."""

from dwgs.warp_start import start_warp

start_warp()
