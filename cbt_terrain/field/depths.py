# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths to which a height field can be refined, and is by default."""

import math

from ...kernels.refine import curve
from .detail import EDGES_A_WAVE
from .detail_bounds import radius_at
from .heightfield import PLANE_BITS, HeightField

# Depth of the tree, root squares included: 8 MB of address space; with displacement half a gigabyte. The system commits
# only pages that are used.
MAX_TREE_DEPTH, MAX_DETAIL_DEPTH = 34, curve.DEEPEST
# Default bisections below the raster's cells: a patch's twist is then 4^4 times smaller.
DEPTH_BELOW_CELLS = 8


def depth_limit(field: HeightField) -> int:
    """Return the deepest bisection of a root square that float32 plane coordinates and the tree can represent."""
    lattice = field.lattice
    side_bits = (max(lattice.columns, lattice.rows) - 1).bit_length()
    tree_depth = MAX_DETAIL_DEPTH if field.detail else MAX_TREE_DEPTH
    return max(1, min(2 * (PLANE_BITS - side_bits), tree_depth - lattice.square_bits))


def usual_depth(field: HeightField) -> int:
    """Return the default depth at which refinement stops; with displacement it resolves the shortest wave."""
    lattice, depth = field.lattice, field.lattice.cell_depth + DEPTH_BELOW_CELLS
    edge = min((part.shortest for part in field.parts), default=0.0) / EDGES_A_WAVE
    if edge:
        longest = 2 * radius_at((lattice.step_x, lattice.step_y), lattice.levels, depth)
        depth += max(0, math.ceil(2 * math.log2(longest / edge)))
    return min(depth, depth_limit(field))
