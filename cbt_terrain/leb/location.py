# SPDX-License-Identifier: GPL-3.0-or-later
"""Point location: the leaf, and the triangle of its meshlet, at a point of the plan.

A point in a triangle has the coordinates (a, b): fractions of the way from the apex to the left and the right corner.
In the halves of a bisection they become (a - b, 1 - a - b) or (1 - a - b, b - a). So the descent in the tree subtracts
integers, exact at any depth, and its bits are the number of a deepest cell: a triangle of the tree's last level.
"""

import numpy as np

from ..field.lattice import Lattice
from ..tree.concurrent_binary_tree import ConcurrentBinaryTree, depths_of

UNIT_BITS = 40  # points are rounded to 2**-UNIT_BITS of a square's side
AT_ONCE = 1 << 14  # points whose data fits the processor's cache during the descent


def locate(tree: ConcurrentBinaryTree, lattice: Lattice, places: np.ndarray, meshlet: int = 0) -> np.ndarray:
    """Return the number of the triangle at each point: int64 [n], counted along the curve; -1 beyond the raster.

    places: float64 [n, 2], x and y in metres in the terrain's space; a NaN is beyond the raster. A point on an edge is
    in one of its two triangles. meshlet: each leaf has 4**meshlet triangles, which are numbered; 0 to number leaves.
    O(depth) a point.
    """
    places = np.asarray(places, np.float64).reshape(-1, 2)
    west, south, east, north = lattice.rectangle()
    inside = ((places >= (west, south)) & (places <= (east, north))).all(axis=1)
    # A square has 2^levels raster cells a side, and 2^UNIT_BITS units.
    unit = np.ldexp((lattice.step_x, lattice.step_y), lattice.levels - UNIT_BITS)
    units = np.rint(np.where(inside[:, None], places - (west, south), 0.0) / unit).astype(np.int64)
    # Points on the far border belong to the triangle inside it.
    ends = np.array([lattice.cells_x, lattice.cells_y]) << UNIT_BITS - lattice.levels
    (column, row), (x, y) = np.divmod(np.minimum(units, ends - 1).T, 1 << UNIT_BITS)
    meshlet_bits = 2 * meshlet
    bisections = tree.max_depth - lattice.square_bits + meshlet_bits  # of a square down to a deepest cell's meshlet
    # Number, along the curve, of the triangle at each point if all leaves were deepest cells: the square, then a bit
    # for each bisection.
    finest = (row * lattice.columns + column) << bisections
    for first in range(0, len(finest), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        finest[part] += _path(x[part], y[part], bisections)
    leaf, ids = tree.find(finest >> meshlet_bits)
    # A leaf of 2^n deepest cells has as many triangles as one of them, so each covers 2^n finest triangles.
    covered_bits = (tree.max_depth - depths_of(ids)).astype(np.int64)
    first_in_leaf = tree.cells_of(ids).astype(np.int64) << meshlet_bits
    return np.where(inside, (leaf.astype(np.int64) << meshlet_bits) + (finest - first_in_leaf >> covered_bits), -1)


def _path(x: np.ndarray, y: np.ndarray, depth: int) -> np.ndarray:
    """Return the path to points of a square, int64: a bit for each of `depth` bisections, the first one the highest.

    A bit is 1 in the second half. x, y: int64, 2^-UNIT_BITS of the square's side from its lower left corner.
    """
    unit = 1 << UNIT_BITS
    second = x + y > unit  # of the square's two halves
    a, b = np.where(second, unit - y, y), np.where(second, unit - x, x)
    path = second.astype(np.int64)
    # a, b: distances of the point from both legs of its triangle, scaled so that a leg is `unit` long. After a second
    # half they are exchanged: `order` is -1. The point is in the second half where a < b, or a > b if exchanged.
    order = np.ones(len(x), np.int64)
    for _ in range(depth - 1):
        difference = a - b
        second = difference * order < 0
        a, b, order = np.abs(difference), unit - a - b, 1 - 2 * second
        path = 2 * path + second
    return path
