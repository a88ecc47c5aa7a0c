# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths to which a height field can be refined, and is by default."""

import math

import numpy as np

from ...kernels.tree.bitfield import MAX_DEPTH
from .detail import EDGES_A_WAVE
from .detail_bounds import radius_at
from .heightfield import PLANE_BITS, HeightField
from .lattice import Lattice

# Depth of the tree, root squares included, and with displacement.
PLAIN_DEPTH, DETAIL_DEPTH = 34, 40
# Rasters with fewer entries keep these depths, and so their meshes; for larger ones plane coordinates are the limit.
MANY_ENTRIES = 2**31
# Default bisections below the raster's cells: a patch's twist is then 4^4 times smaller.
DEPTH_BELOW_CELLS = 8


def depth_limit(field: HeightField) -> int:
    """Return the deepest bisection of a root square that float32 plane coordinates and the tree can represent.

    The cells, also those of finer tiles, are reached in any case: float32 can represent them where the anchor, from
    which coordinates count, is near.
    """
    lattice, finer = field.lattice, field.raster.finer
    limit = plane_limit(lattice)
    if lattice.node_count < MANY_ENTRIES:  # for larger rasters the plane is the only limit
        # A limit for the depth of the tree, which has `square_bits` levels above the root squares.
        is_finer = field.detail is not None or finer is not None
        limit = min(limit, (DETAIL_DEPTH if is_finer else PLAIN_DEPTH) - lattice.square_bits)
    limit = max(limit, lattice.cell_depth + (2 * finer.bits if finer is not None else 0))
    # Two bisections halve a side: down to one integer unit.
    return max(1, min(limit, 2 * lattice.unit_bits + 1, MAX_DEPTH - lattice.square_bits))


def plane_limit(lattice: Lattice) -> int:
    """Return the deepest bisection of a root square that float32 plane coordinates represent everywhere."""
    return 2 * (PLANE_BITS - lattice.side_bits)


def depth_in_plane(lattice: Lattice, positions: np.ndarray, corner_verts: np.ndarray, level: np.ndarray) -> int | None:
    """Return the deepest bisection that float32 represents at all triangles of a mesh; None if it represents the mesh.

    Lattice lines at a triangle's depth have to be 2^-PLANE_BITS of its farthest coordinate apart, or more.

    Args:
        lattice: of the mesh; coordinates are relative to its anchor.
        positions: float32 [vertices, 3] metres.
        corner_verts: indices of vertices, three for each triangle.
        level: bisection (depth in its root square) of each triangle.
    """
    deep = np.flatnonzero(level > plane_limit(lattice))
    corners = positions[corner_verts.reshape(-1, 3)[deep], :2].astype(np.float64)
    steps = np.array([lattice.step_x, lattice.step_y])
    needed = np.ldexp(np.abs(corners).max(axis=1, initial=0.0) / steps, -PLANE_BITS).max(axis=1, initial=0.0)  # cells
    # Lattice lines at depth d are 2^(levels - d // 2) cells apart; each triangle needs at least `needed` cells.
    beyond = np.ldexp(1.0, lattice.levels - (level[deep] >> 1)) < needed
    if not beyond.any():
        return None
    # The deepest depth with lines at least the largest need apart: 2^e cells, because a number m * 2^e with m in
    # [0.5, 1) is at most 2^e, or 2^(e - 1) if m is 0.5.
    fraction, exponent = np.frexp(needed[beyond].max())
    return max(1, 2 * (lattice.levels - int(exponent) + int(fraction == 0.5)) + 1)


def usual_depth(field: HeightField) -> int:
    """Return the default depth of a root square at which refinement stops, at most `depth_limit`.

    It is DEPTH_BELOW_CELLS bisections below the raster's cells. With finer tiles these are counted from their cells.
    With displacement the depth is at least such that the shortest wave has EDGES_A_WAVE edges.
    """
    lattice, depth = field.lattice, field.lattice.cell_depth + DEPTH_BELOW_CELLS
    if field.raster.finer is not None:
        depth += 2 * field.raster.finer.bits
    edge = min((wave.shortest for wave in field.parts), default=0.0) / EDGES_A_WAVE  # metres, 0 without displacement
    if edge:
        longest = 2 * radius_at((lattice.step_x, lattice.step_y), lattice.levels, depth)
        depth += max(0, math.ceil(2 * math.log2(longest / edge)))  # two bisections halve an edge
    return min(depth, depth_limit(field))
