# SPDX-License-Identifier: GPL-3.0-or-later
"""Holes: the cells of a raster with a missing sample, which are cut out of the mesh.

Missing samples are filled as usual; `valid` marks them. Those beside ground then continue its slopes, so that normals
and a bicubic surface at the border of a hole are those of the ground alone. The fill is no ground: errors do not count
there (`measured` of hierarchy.py), and limits of heights leave it out.

A triangle on the border of a hole shows the border in the wrong position, by at most its longest edge. That length is
its error, so the border is refined like everything else, down to the sides of the raster's cells. It is a horizontal
length that counts as a vertical one, and scales with the heights.
"""

from functools import partial

import numpy as np
import warp as wp

from ...kernels.field import holes as kernels
from ..run import launch
from ..run.buffers import flat
from ..view.linear import length
from .hierarchy import stored_at, upward
from .lattice import Lattice


def holes_leave_ground(valid: np.ndarray) -> bool:
    """Return whether any cell has all its four samples, so that a mesh remains.

    valid: bool [rows, columns], of a raster or of at least two of its rows.
    """
    rows = (south & north for south, north in zip(valid[:-1], valid[1:], strict=True))
    return any((row[:-1] & row[1:]).any() for row in rows)


def holes_around(valid: np.ndarray, bits: int, x: np.ndarray, y: np.ndarray, join: np.ufunc) -> np.ndarray:
    """Return whether one or all of the cells that meet at samples are holes: bool [rows, columns].

    valid: uint8 [height, width], 0 where a sample of the raster is missing. x, y: ascending columns and rows of the
    samples, which are 2^bits a cell. join: np.logical_or for one, np.logical_and for all.
    """
    # For each sample the cells before and after it along both axes; both are the same inside of a cell.
    (south, north), (west, east) = (
        [np.clip(at - before >> bits, 0, count - 2) for before in (1, 0)]
        for at, count in zip((y, x), valid.shape, strict=True)
    )
    known = valid[south[0] : north[-1] + 2, west[0] : east[-1] + 2] > 0
    is_hole = ~(known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:])
    rows = join(is_hole[south - south[0]], is_hole[north - south[0]])
    return join(rows[:, west - west[0]], rows[:, east - west[0]])


def refine_borders(valid: np.ndarray, lattice: Lattice, errors: np.ndarray, threads: int) -> np.ndarray:
    """Raise `errors` (float32 [lattice.node_count], metres) of diamonds on the border of a hole.

    Return the kinds of cells (ground 1, hole 2, both 3) below each diamond, uint8 like `errors`; tiles of a large
    raster store them. valid: uint8 [height, width], 0 where a sample is missing.
    """
    cell_kinds = np.zeros(lattice.node_count, np.uint8)
    kinds, out = flat(cell_kinds, wp.uint8), flat(errors, wp.float32)

    cells = stored_at(lattice, lattice.cell_depth)
    inputs = [flat(valid, wp.uint8), lattice.width, cells, kinds]
    launch.spread(kernels.cell_kinds, lattice.cells_y, inputs, step="holes", threads=threads, cost=lattice.cells_x)
    for depth, finer, coarser, count in upward(lattice.cell_depth, partial(stored_at, lattice)):
        inputs = [wp.float32(longest_edge(lattice, depth)), finer, coarser, kinds, out]
        launch.spread(kernels.raise_borders, count, inputs, step="holes", threads=threads)
    return cell_kinds


def longest_edge(lattice: Lattice, depth: int) -> float:
    """Return the longest edge, metres in the plane, of a diamond at a depth (1 .. cell_depth)."""
    side = 2.0 ** (lattice.levels - (depth - 1) // 2)
    return side * (length((lattice.step_x, lattice.step_y)) if depth % 2 else max(lattice.step_x, lattice.step_y))
