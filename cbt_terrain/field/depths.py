# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths to which a height field can be refined, and is by default."""

import math

from .detail import EDGES_A_WAVE
from .detail_bounds import radius_at
from .heightfield import PLANE_BITS, HeightField

# Depth of the tree, root squares included, and with displacement.
PLAIN_DEPTH, DETAIL_DEPTH = 34, 40
# Rasters with fewer entries keep these depths, and so their meshes; for larger ones plane coordinates are the limit.
MANY_ENTRIES = 2**31
# Default bisections below the raster's cells: a patch's twist is then 4^4 times smaller.
DEPTH_BELOW_CELLS = 8


def depth_limit(field: HeightField) -> int:
    """Return the deepest bisection of a root square that float32 plane coordinates and the tree can represent."""
    lattice = field.lattice
    limit = 2 * (PLANE_BITS - lattice.side_bits)
    if lattice.node_count < MANY_ENTRIES:
        is_finer = field.detail is not None or field.raster.finer is not None
        limit = min(limit, (DETAIL_DEPTH if is_finer else PLAIN_DEPTH) - lattice.square_bits)
    return max(1, limit)


def usual_depth(field: HeightField) -> int:
    """Return the default depth of a root square at which refinement stops, at most `depth_limit`.

    With displacement it resolves the shortest wave, with finer tiles their cells.
    """
    lattice, depth = field.lattice, field.lattice.cell_depth + DEPTH_BELOW_CELLS
    if field.raster.finer is not None:
        depth += 2 * field.raster.finer.bits
    edge = min((part.shortest for part in field.parts), default=0.0) / EDGES_A_WAVE
    if edge:
        longest = 2 * radius_at((lattice.step_x, lattice.step_y), lattice.levels, depth)
        depth += max(0, math.ceil(2 * math.log2(longest / edge)))
    return min(depth, depth_limit(field))
