# SPDX-License-Identifier: GPL-3.0-or-later
"""The classic update of a concurrent binary tree (Dupuy 2020; Deliot and Dupuy 2021): every leaf decides for itself.

A leaf whose diamond is too coarse is split; one whose parent's diamond is not is merged, with the other halves of that
diamond. The criterion is nested, so every diamond that a split forces to be split is too coarse, too: no leaf takes
part in a split and in a merge, and both may be written in one pass. `t`: the tree's bit field, whose leaves are
numbered in curve order. `grid`: the root squares.
"""

import warp as wp

from ..field.domain import INLINED, Domain
from ..leb.bisection import SquareGrid, can_merge, node_of, split_conforming, triangle_of
from ..leb.halfway import middle_between
from ..tree.atomic import highest_bit
from ..tree.bitfield import ONE, Bitfield, decode_leaf, heap_id_of
from ..tree.edits import merge
from .interval import measure_diamond, too_coarse
from .pixels import CriterionArrays
from .stored_errors import error_at

wp.set_module_options(INLINED)

MERGE = wp.constant(wp.uint64(1 << 63))  # an order to merge the children of a node; without it, to split a leaf


@wp.func
def is_too_coarse(domain: Domain, criterion: CriterionArrays, middle: wp.vec2i, depth: wp.int32) -> wp.bool:
    """Return whether the diamond of a depth, split at `middle` (lattice units), exceeds the criterion."""
    error = error_at(domain, middle[0], middle[1], depth)
    return too_coarse(
        criterion, criterion.limit, measure_diamond(domain, criterion, middle[0], middle[1], depth, error, 0)
    )


@wp.kernel
def decide(
    offset: wp.int32,
    t: Bitfield,
    grid: SquareGrid,
    domain: Domain,
    criterion: CriterionArrays,
    max_depth: wp.int32,
    orders: wp.array(dtype=wp.uint64),
):
    """Write to orders[k] the order for leaf k = offset + tid: a node to split, MERGE plus a node, or 0.

    MERGE plus a node merges the children of that node. max_depth: largest number of bisections of a square; deeper
    leaves are merged.
    """
    k = offset + wp.tid()
    tree_id = heap_id_of(t, decode_leaf(t, k))
    node = node_of(grid, tree_id)
    depth = highest_bit(node.heap_id)
    order = wp.uint64(0)
    if depth > 0:  # squares that only fill the tree up to a power of two are a leaf each
        left, apex, right = triangle_of(node, domain.unit_bits)
        middle = middle_between(left, right)
        levels_up = wp.int32(0)  # 0: test the leaf's diamond; 1: its parent's
        while levels_up < wp.min(depth, 2) and order == wp.uint64(0):
            splits = depth - levels_up < max_depth
            if splits:
                splits = is_too_coarse(domain, criterion, middle, depth - levels_up)
            if levels_up == 0 and splits:
                order = tree_id
            elif levels_up == 1 and not splits:
                if can_merge(t, grid, tree_id >> ONE):
                    order = MERGE | (tree_id >> ONE)
            middle = apex  # the vertex at which the parent's diamond was split
            levels_up += 1
    orders[k] = order


@wp.kernel
def carry_out(offset: wp.int32, t: Bitfield, grid: SquareGrid, orders: wp.array(dtype=wp.uint64)):
    """Carry out orders[offset + tid], from `decide`: split a node, merge the children of one, or nothing."""
    order = orders[offset + wp.tid()]
    if order >= MERGE:
        merge(t, order - MERGE)
    elif order != wp.uint64(0):
        split_conforming(t, grid, order)
