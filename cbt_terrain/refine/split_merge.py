# SPDX-License-Identifier: GPL-3.0-or-later
"""The classic update of a concurrent binary tree: one pass of split and merge decisions over all leaves a frame.

The walk (kernels/refine/walk.py) finds the same leaves in one call from the roots. This is the reference that it is
compared with in docs/method.md: it needs a pass for each level that a leaf is to go down or up.
"""

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine import split_merge as kernels
from ...kernels.refine.pixels import CriterionArrays
from ..field.lattice import Lattice
from ..leb.bisection import grid_of
from ..run import launch
from ..run.buffers import shared
from ..tree.concurrent_binary_tree import ConcurrentBinaryTree

DECISION_COST = 40.0  # of a leaf's decision, in array lookups (15 ns); small jobs stay on one thread


def split_merge(
    tree: ConcurrentBinaryTree, lattice: Lattice, domain: Domain, criterion: CriterionArrays, max_depth: int
) -> int:
    """Split and merge the leaves of a tree over the lattice's squares by at most one level towards the criterion.

    Returns the number of leaves that were split or merged; 0 once the tree is the refinement. max_depth: bisections of
    a square.
    """
    # of each leaf: the node to split, the one whose children are to be merged, or 0
    orders, grid = np.empty(tree.leaf_count, np.uint64), grid_of(lattice)
    shared_orders = shared(orders, wp.uint64)
    inputs = [tree.bits, grid, domain, criterion, max_depth, shared_orders]
    launch.spread(kernels.decide, len(orders), inputs, step="decide", threads=tree.threads, cost=DECISION_COST)
    decided = int(np.count_nonzero(orders))
    if decided:
        tree.edit(kernels.carry_out, len(orders), [grid, shared_orders])
    return decided
