# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the error hierarchy and the height ranges hold a diamond; `cbt_terrain/field/lattice.py` says why."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def tile_index(x: wp.int32, y: wp.int32, pages: wp.int32) -> wp.int64:
    """Entry of the vertex (x, y) of a group, counted from the group's first, where a row of the group has `pages`.

    Pages of 32 x 32 vertices are row-major in the group, tiles of 4 x 4 row-major in a page, vertices in a tile.
    """
    page = wp.int64(y >> 5) * wp.int64(pages) + wp.int64(x >> 5)
    inside = ((y & 28) << 5) | ((x & 28) << 2) | ((y & 3) << 2) | (x & 3)
    return (page << wp.int64(10)) | wp.int64(inside)


@wp.struct
class Depth:
    """Where the arrays hold the diamonds of one depth.

    They are counted by cells (odd depths) or by the corners of cells of half the side (even depths), (0, 0) in the
    south-west; number (x, y) is the vertex (first + x * step, first + y * step) of its group.
    """

    base: wp.int64
    pages: wp.int32
    first: wp.int32
    step: wp.int32


@wp.func
def entry(depth: Depth, x: wp.int32, y: wp.int32) -> wp.int64:
    """Entry of the diamond (x, y) of a depth."""
    return depth.base + tile_index(depth.first + x * depth.step, depth.first + y * depth.step, depth.pages)
