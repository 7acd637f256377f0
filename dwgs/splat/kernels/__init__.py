"""Warp kernels, one pass per file; they know arrays, not tensors."""

import warp as wp

wp.config.log_level = wp.LOG_ERROR  # standard output belongs to the programs
