# SPDX-License-Identifier: GPL-3.0-or-later
"""Layout of diamonds in the error hierarchy and the height ranges: see `cbt_terrain/field/lattice.py`.

A *diamond* is the pair of triangles that share a longest edge, in the middle of which both are split. Diamonds of four
depths make a *group*, which is stored as an image of these middles. A diamond's children are those of the next depth
that are split in the middles of its triangles' other edges. Of a Depth: `sides` is 1 if its diamonds are centred on the
sides of `columns` x `rows` cells, at (x, y) with x + y odd, in steps of half a side; it is 0 if they are those of the
cells.
"""

import warp as wp

from ..unchecked import item_at

PAGE_BITS = wp.constant(wp.int64(10))  # a page has 2^10 entries


@wp.func
def tile_index(x: wp.int32, y: wp.int32, pages: wp.int32) -> wp.int64:
    """Return the entry of the vertex (x, y) of a group with `pages` a row, from the group's first entry.

    Pages of 32 x 32 vertices are row-major in the group, tiles of 4 x 4 row-major in a page, vertices in a tile.
    """
    page = wp.int64(y >> 5) * wp.int64(pages) + wp.int64(x >> 5)
    # Bits 2 .. 4 of x and y choose the tile in its page, the lowest two the vertex in its tile.
    inside = ((y & 28) << 5) | ((x & 28) << 2) | ((y & 3) << 2) | (x & 3)
    return (page << wp.int64(10)) | wp.int64(inside)


@wp.func
def stored_entry(places: wp.array(dtype=wp.int32), entry: wp.int64) -> wp.int64:
    """Return where an entry is in memory: equal pages may be stored once.

    places: number of the stored page for each page; empty if each page is stored where its entries say.
    """
    if places.shape[0] > 0:
        page = wp.int64(item_at(places, entry >> PAGE_BITS))
        entry = (page << PAGE_BITS) | (entry & wp.int64(1023))
    return entry


@wp.struct
class Depth:
    """The diamonds of one depth, and where the arrays hold them.

    They are the middles of `columns` x `rows` cells (odd depths, `sides` 0), or of the sides of such cells (even
    depths, `sides` 1). The diamond of a cell has the cell's (x, y). That of a side has the position of the side's
    middle in steps of half a side, so that x + y is odd. (0, 0) is in the south-west; (x, y) is the vertex
    (first + x * step, first + y * step) of its group.
    """

    columns: wp.int32  # of sides: cells of half the side
    rows: wp.int32
    sides: wp.int32
    base: wp.int64  # entry in the arrays of the first vertex of the group of depths that holds this depth
    pages: wp.int32  # pages in a row of that group, see `tile_index`
    first: wp.int32
    step: wp.int32


@wp.func
def entry(depth: Depth, x: wp.int32, y: wp.int32) -> wp.int64:
    """Return the index of diamond (x, y) of a depth in the arrays of errors and ranges."""
    return depth.base + tile_index(depth.first + x * depth.step, depth.first + y * depth.step, depth.pages)


@wp.func
def diamond(depth: Depth, t: wp.int64) -> wp.vec2i:
    """Return diamond number `t` of a depth, row by row; `holds` tells whether it exists.

    In a row of sides with an even y the last number is beyond the east end: there is one side less than with an odd y.
    """
    stride = wp.where(depth.sides == 1, depth.columns / 2 + 1, depth.columns)
    y = wp.int32(t / wp.int64(stride))
    x = wp.int32(t - wp.int64(y) * wp.int64(stride))
    if depth.sides == 1:
        x = 2 * x + ((y + 1) & 1)
    return wp.vec2i(x, y)


@wp.func
def holds(depth: Depth, p: wp.vec2i) -> wp.bool:
    """Return whether diamond p of a depth exists, that is, is not outside the raster."""
    x = wp.uint32(p[0])  # a negative number is a large one
    y = wp.uint32(p[1])
    return x < wp.uint32(depth.columns + depth.sides) and y < wp.uint32(depth.rows + depth.sides)


@wp.func
def child(depth: Depth, p: wp.vec2i, k: wp.int32) -> wp.vec2i:
    """Return child k (0 .. 3) of a diamond: the middle of a side or of a cell; `holds` tells whether it exists.

    depth: layout of the diamond's own depth. p: the diamond's position in it.
    """
    c = wp.vec2i(p[0] - (k & 1), p[1] - (k >> 1))  # of a side: the cells, half as wide, that touch its middle
    if depth.sides == 0:  # of a cell: its four sides
        ahead = 2 * (k & 1)
        c = wp.vec2i(2 * p[0] + wp.where(k < 2, ahead, 1), 2 * p[1] + wp.where(k < 2, 1, ahead))
    return c
