"""The order in which splats are drawn."""

import numpy as np
from numpy.typing import NDArray

CULLED = np.uint32(0xFFFFFFFF)
"""Key of a splat that is not drawn; no finite positive depth has these bits."""


def back_to_front(keys: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Indices of the splats that are not culled, farthest first.

    Keys are the bits of positive float32 depths, which sort like the depths. All 32 bits count: with 16 an
    image falls to 50 dB. Of equal depths the first in the buffer lies in front, as in the splatter. NumPy
    sorts 16-bit keys stably by radix and wider ones by merging: two narrow passes are faster than a wide one.
    """
    visible = np.flatnonzero(keys != CULLED)
    keys = keys[visible]
    by_low = np.argsort(keys.astype(np.uint16), kind="stable")
    by_high = np.argsort((keys >> 16).astype(np.uint16)[by_low], kind="stable")
    return visible[by_low[by_high]][::-1].astype(np.uint32)
