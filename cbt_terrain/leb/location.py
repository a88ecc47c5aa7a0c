# SPDX-License-Identifier: GPL-3.0-or-later
"""Point location: which leaf, and which triangle of its meshlet, is at a place of the plan.

In a triangle a place has two coordinates (a, b), its parts of the way from the apex to the left and to the right
corner. In the two halves of a bisection it has (a - b, 1 - a - b) or (1 - a - b, b - a): so the way down the tree is
subtractions of integers, exact however deep it is, and its bits are the number of a deepest cell.
"""

import numpy as np

from ..field.lattice import Lattice
from ..tree.concurrent_binary_tree import ConcurrentBinaryTree, depths_of

UNIT_BITS = 40  # of a square's side: what places are rounded to
AT_ONCE = 1 << 14  # places whose numbers stay in the processor's cache on the way down


def locate(tree: ConcurrentBinaryTree, lattice: Lattice, places: np.ndarray, meshlet: int = 0) -> np.ndarray:
    """Numbers of the triangles at `places`, in curve order, 4**meshlet for each leaf: int64 [n]; -1 beyond the raster.

    places: float64 [n, 2], x and y in metres in the terrain's own space. A place on an edge is in either triangle
    beside it. Without meshlets a number is that of a leaf in the tree. O(depth) a place.
    """
    places = np.asarray(places, np.float64).reshape(-1, 2)
    west, south, east, north = lattice.rectangle()
    inside = ((places >= (west, south)) & (places <= (east, north))).all(axis=1)
    unit = np.ldexp((lattice.step_x, lattice.step_y), lattice.levels - UNIT_BITS)
    units = np.rint(np.where(inside[:, None], places - (west, south), 0.0) / unit).astype(np.int64)
    # What is on the rim is in the triangle within it.
    ends = np.array([lattice.cells_x, lattice.cells_y]) << UNIT_BITS - lattice.levels
    (column, row), (x, y) = np.divmod(np.minimum(units, ends - 1).T, 1 << UNIT_BITS)
    depth, below = tree.max_depth - lattice.square_bits, 2 * meshlet
    path = (row * lattice.columns + column) << depth + below
    for first in range(0, len(path), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        path[part] += _path(x[part], y[part], depth + below)
    leaf, ids = tree.find(path >> below)
    # A leaf of 2^n cells has 2^n steps of the path in each of its triangles.
    step_bits = (tree.max_depth - depths_of(ids)).astype(np.int64)
    first_step = tree.cells_of(ids).astype(np.int64) << below
    return np.where(inside, (leaf.astype(np.int64) << below) + (path - first_step >> step_bits), -1)


def _path(x: np.ndarray, y: np.ndarray, depth: int) -> np.ndarray:
    """Which halves hold places of a square, int64: a bit for each of `depth` bisections, the first one highest."""
    unit = 1 << UNIT_BITS
    second = x + y > unit  # of the square's two halves
    a, b = np.where(second, unit - y, y), np.where(second, unit - x, x)
    path = second.astype(np.int64)
    # The halves' coordinates are the same two, in the other order: `order` is -1 where a and b have changed places.
    order = np.ones(len(x), np.int64)
    for _ in range(depth - 1):
        ahead = a - b
        second = ahead * order < 0
        a, b, order = np.abs(ahead), unit - a - b, 1 - 2 * second
        path = 2 * path + second
    return path
