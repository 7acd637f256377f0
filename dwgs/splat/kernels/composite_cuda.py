"""CUDA scheme (to come)."""

import warp as wp

WARPS_PER_TILE = 8
