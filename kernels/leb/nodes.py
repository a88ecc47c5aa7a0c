# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles, neighbours and conforming edits of many nodes at once.

Nodes are given by their heap ids in the tree of all root squares, whose root is 1; node n has the children 2n, 2n + 1.
"""

import warp as wp

from ..tree.bitfield import Bitfield
from .bisection import SquareGrid, neighbours_of, node_of, split_conforming, tree_id_of, triangle_of


@wp.kernel
def write_triangles(
    offset: wp.int32,
    grid: SquareGrid,
    ids: wp.array(dtype=wp.uint64),
    unit_bits: wp.int32,
    out: wp.array(dtype=wp.vec2i),
):
    """Write left, apex and right of node ids[offset + tid], lattice units: 2^unit_bits are a square's side."""
    k = offset + wp.tid()
    left, apex, right = triangle_of(node_of(grid, ids[k]), unit_bits)
    out[3 * k] = left
    out[3 * k + 1] = apex
    out[3 * k + 2] = right


@wp.kernel
def write_neighbours(
    offset: wp.int32, grid: SquareGrid, ids: wp.array(dtype=wp.uint64), out: wp.array(dtype=wp.uint64)
):
    """Write the heap ids of the neighbours of node ids[offset + tid], of the same depth, to out; 0 beyond the grid.

    They are those across the edges apex-right ("left"), left-apex ("right") and left-right ("edge").
    """
    k = offset + wp.tid()
    left, right, edge = neighbours_of(grid, node_of(grid, ids[k]))
    out[3 * k] = tree_id_of(grid, left)
    out[3 * k + 1] = tree_id_of(grid, right)
    out[3 * k + 2] = tree_id_of(grid, edge)


@wp.kernel
def split_diamonds(offset: wp.int32, t: Bitfield, grid: SquareGrid, ids: wp.array(dtype=wp.uint64)):
    """Split leaf ids[offset + tid] with its diamond, after coarser neighbours, so that the mesh stays conforming."""
    split_conforming(t, grid, ids[offset + wp.tid()])
