# SPDX-License-Identifier: GPL-3.0-or-later
"""Holes: the cells of a raster that have a missing sample, where the mesh is to be cut out.

The samples are filled like any other missing ones, so that nothing has to know; `valid` says which they were. What a
hole is filled with is no ground, so errors do not count there (`measured` of hierarchy.py). A triangle that lies on the
border of a hole shows it in the wrong place, by no more than its own longest edge: that is its error then, so that the
border is refined as everything else is, down to the raster's cells, along whose sides it runs. It is a length in the
plane, taken for one of height; where heights are scaled, so is it.
"""

from functools import partial

import numpy as np
import warp as wp

from ...kernels.field import holes as kernels
from ..ask.linear import length
from ..run import launch
from ..run.buffers import flat
from .hierarchy import stored_at, upward
from .lattice import Lattice


def holes_leave_ground(valid: np.ndarray) -> bool:
    """Whether any cell has all its four samples. valid: bool [height, width]."""
    rows = (south & north for south, north in zip(valid[:-1], valid[1:], strict=True))
    return any((row[:-1] & row[1:]).any() for row in rows)


def refine_borders(valid: np.ndarray, lattice: Lattice, errors: np.ndarray, threads: int) -> None:
    """Raise `errors` (float32 [lattice.node_count], metres) of what lies on the border of a hole.

    valid: uint8 [height, width], 0 where a sample is missing.
    """
    kinds, out = flat(np.zeros(lattice.node_count, np.uint8), wp.uint8), flat(errors, wp.float32)

    cells = stored_at(lattice, lattice.cell_depth)
    inputs = [flat(valid, wp.uint8), lattice.width, cells, kinds]
    launch.spread(kernels.cell_kinds, lattice.cells_y, inputs, step="holes", threads=threads, cost=lattice.cells_x)
    for depth, finer, own, count in upward(lattice.cell_depth, partial(stored_at, lattice)):
        inputs = [wp.float32(longest_edge(lattice, depth)), finer, own, kinds, out]
        launch.spread(kernels.raise_borders, count, inputs, step="holes", threads=threads)


def longest_edge(lattice: Lattice, depth: int) -> float:
    """Metres, in the plane, of the longest edge of a diamond at a depth (1 .. cell_depth)."""
    side = 2.0 ** (lattice.levels - (depth - 1) // 2)
    return side * (length((lattice.step_x, lattice.step_y)) if depth % 2 else max(lattice.step_x, lattice.step_y))
