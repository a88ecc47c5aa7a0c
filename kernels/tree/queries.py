# SPDX-License-Identifier: GPL-3.0-or-later
"""Queries of many leaves at once. `t` is the tree's Bitfield.

A node's heap id is 1 at the root; node n has the children 2n and 2n + 1.
"""

import warp as wp

from .bitfield import Bitfield, decode_leaf, heap_id_of, leaf_at


@wp.kernel
def decode_leaves(offset: wp.int32, t: Bitfield, numbers: wp.array(dtype=wp.int32), ids: wp.array(dtype=wp.uint64)):
    """Write to ids[k] the heap id of leaf numbers[k], counted along the curve, for k = offset + tid."""
    k = offset + wp.tid()
    ids[k] = heap_id_of(t, decode_leaf(t, numbers[k]))


@wp.kernel
def find_leaves(
    offset: wp.int32,
    t: Bitfield,
    cells: wp.array(dtype=wp.uint64),
    numbers: wp.array(dtype=wp.int32),
    ids: wp.array(dtype=wp.uint64),
):
    """Write number and heap id of the leaf that contains deepest cell cells[k] to numbers[k] and ids[k].

    k = offset + tid. A deepest cell is a node of the deepest level, by its number along the curve, from 0.
    """
    k = offset + wp.tid()
    leaf = leaf_at(t, cells[k])
    numbers[k] = leaf.number
    ids[k] = heap_id_of(t, leaf)
