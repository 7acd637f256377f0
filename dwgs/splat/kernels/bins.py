# type: ignore  (Warp's language, which is not Python's)
"""Which Gaussians touch which tile, nearest first: what both ways of finding it out share.

An intersection is one Gaussian in one tile. Those of one Gaussian are numbered side by side, which `gather`
lives on; sorted they lie tile by tile, and in each tile by depth, then by number.
"""

import warp as wp

from dwgs.splat.constants import TILE

wp.set_module_options({"enable_backward": False})


@wp.struct
class Bins:
    """What a tile has to draw: intersections ``ranges[tile]`` of the sorted order, nearest first."""

    ranges: wp.array(dtype=wp.vec2i)
    isect_from_sorted: wp.array(dtype=int)
    gaussian_from_isect: wp.array(dtype=int)


TOUCHED = f"""
    auto reach = [](float to, int tiles) -> int {{  // tiles whose first pixel centre lies left of it
        const float count = (to - 0.5f) / {TILE}.0f;
        return count < 0.0f ? 0 : count < tiles ? (int)count : tiles;
    }};
    auto touched = [&](int i) -> wp::vec4i {{
        const float* record = (const float*)&records.data[i];
        const float x = record[0], y = record[1], extent_x = record[10], extent_y = record[11];
        if (!(extent_x > 0.0f)) return wp::vec4i(0, 0, 0, 0);
        const int above = i / per_view * tiles[1];  // images lie one under the other
        return wp::vec4i(
            reach(x - extent_x, tiles[0]), reach(x + extent_x + {TILE}, tiles[0]),
            above + reach(y - extent_y, tiles[1]), above + reach(y + extent_y + {TILE}, tiles[1]));
    }};
"""
"""Which columns and rows of tiles Gaussian i reaches: first, one past the last; none if it is not drawn."""
