# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection of a lattice's root squares, for many nodes at once. kernels/leb/bisection.py has the rules.

Nodes are heap ids of the tree of the whole lattice, uint64; triangles are those below its squares, at depths
`lattice.square_bits` + 1 and more.
"""

import numpy as np
import warp as wp

from ...kernels.leb import bisection as kernels
from ...kernels.leb import nodes
from ..errors import TerrainError
from ..field.lattice import Lattice
from ..run import launch
from ..run.buffers import flat, shared
from ..tree.concurrent_binary_tree import ConcurrentBinaryTree

NODE_COST = 5.0  # of a node's triangle or neighbours, in array lookups (15 ns); small jobs stay on one thread


def grid_of(lattice: Lattice) -> kernels.SquareGrid:
    """Return the lattice's root squares as kernels read them."""
    grid = kernels.SquareGrid()
    grid.columns, grid.rows, grid.square_bits = lattice.columns, lattice.rows, lattice.square_bits
    return grid


def triangles(lattice: Lattice, ids: np.ndarray, unit_bits: int) -> np.ndarray:
    """Return the corners (left, apex, right) of triangles: int32 [n, 3, 2], x and y in units.

    Units are counted from the lattice's south-west corner; 2**unit_bits units are the side of a square. A triangle of d
    bisections of a square needs unit_bits of d // 2 or more.
    """
    corners = np.empty((len(ids), 3, 2), np.int32)
    _launch(nodes.write_triangles, lattice, ids, [unit_bits, shared(corners.reshape(-1, 2), wp.vec2i)])
    return corners


def neighbours(lattice: Lattice, ids: np.ndarray) -> np.ndarray:
    """Return the triangles of the same depth over the edges apex-right, left-apex and left-right.

    uint64 [n, 3]; 0 beyond the lattice. The last one is the other half of the diamond.
    """
    found = np.empty((len(ids), 3), np.uint64)
    _launch(nodes.write_neighbours, lattice, ids, [flat(found, wp.uint64)])
    return found


def plant(tree: ConcurrentBinaryTree, lattice: Lattice) -> None:
    """Replace the tree's leaves by the two roots of each square, and one leaf for each number after the last square.

    Squares are numbered up to a power of two, 2^square_bits. Raises TerrainError for a tree that is too shallow for
    them.
    """
    if tree.max_depth <= lattice.square_bits:
        raise TerrainError(
            f"A tree of depth {tree.max_depth} is too shallow for {lattice.squares} root squares",
            expected=f"a depth of {lattice.square_bits + 1} or more",
        )
    roots = np.full(2 * lattice.squares, lattice.square_bits + 1)
    tree.set_depths(np.append(roots, np.full((1 << lattice.square_bits) - lattice.squares, lattice.square_bits)))


def split_conforming(tree: ConcurrentBinaryTree, lattice: Lattice, ids: np.ndarray) -> None:
    """Split leaves above the deepest level with the other halves of their diamonds, and with coarser neighbours.

    Only neighbours are split that would leave a crack.
    """
    ids = np.ascontiguousarray(ids, np.uint64)
    tree.edit(nodes.split_diamonds, len(ids), [grid_of(lattice), shared(ids, wp.uint64)])


def merge_conforming(tree: ConcurrentBinaryTree, lattice: Lattice, ids: np.ndarray) -> np.ndarray:
    """Merge the halves of nodes and of the other triangles of their diamonds, if all of them are leaves.

    Return which nodes were merged, bool [n]: a node is left as it is if any of the four halves is no leaf.
    """
    ids = np.ascontiguousarray(ids, np.uint64)
    pairs = np.stack([ids, neighbours(lattice, ids)[:, 2]], axis=1)  # the second is 0 beyond the lattice
    halves = pairs[:, :, None] * np.uint64(2) + np.array([0, 1], np.uint64)
    are_leaves = tree.is_leaf(np.maximum(halves, 1).ravel()).reshape(halves.shape).all(axis=2)
    is_merged = ((pairs == 0) | are_leaves).all(axis=1)
    tree.merge(np.setdiff1d(pairs[is_merged], [0]))
    return is_merged


def _launch(kernel: wp.Kernel, lattice: Lattice, ids: np.ndarray, inputs: list) -> None:
    """Launch a kernel over nodes, by heap id, uint64 [n]. inputs: its arguments after the lattice and the ids."""
    items = shared(np.ascontiguousarray(ids, np.uint64), wp.uint64)
    launch.spread(kernel, len(ids), [grid_of(lattice), items, *inputs], step="leb", cost=NODE_COST)
