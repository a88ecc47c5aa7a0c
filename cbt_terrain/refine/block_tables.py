# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of blocks: leaves and new vertices of an evenly bisected triangle, for each state of the curve.

The curve through the leaves enters and leaves a triangle through two of its edges. A *state* is which two they are: two
legs (LEG_LEG), the longest edge and a leg, or a leg and the longest edge; and, as its lowest bit, 1 if the third edge
was passed before.
"""

from functools import cache

import numpy as np
import warp as wp

from ...kernels.refine import curve
from ...kernels.refine.block import MAX_BISECTIONS, BlockTable

STATES = 6


def bisected_states(state: int, bisections: int) -> tuple[list[int], list[tuple[int, int]]]:
    """Return the leaves of a uniformly bisected triangle, as states in curve order, and its new vertices.

    A vertex is (a, b): from the apex a and b times 2^-ceil(bisections / 2) of the legs towards left and right.
    bisections: depth of all leaves. state: how the curve passes the triangle.
    """
    leaves: list[int] = []
    vertices: list[tuple[int, int]] = []
    unit = 1 << (bisections + 1) // 2

    def walk(
        left: tuple[int, int], apex: tuple[int, int], right: tuple[int, int], state: int, bisections_left: int
    ) -> None:
        """Append the leaves and new vertices below a triangle, `bisections_left` bisections deep, in curve order."""
        if not bisections_left:
            leaves.append(state)
            if state % 2 == 0:  # the edge that the curve does not cross is new, and its end is a new vertex
                vertices.append(apex if state == curve.HYP_LEG else right)
            return
        # LEFT_STATES and RIGHT_STATES hold a child's state, 0 .. 5, in 4 bits for each state of the parent
        middle = (left[0] + right[0]) // 2, (left[1] + right[1]) // 2
        walk(left, middle, apex, curve.LEFT_STATES >> 4 * state & 7, bisections_left - 1)
        walk(apex, middle, right, curve.RIGHT_STATES >> 4 * state & 7, bisections_left - 1)

    walk((unit, 0), (0, 0), (0, unit), state, bisections)
    return leaves, vertices


def _array(values: list, dtype: type) -> wp.array:
    """Return a Warp array of the values, whose Warp dtype is uint16, int32 or vec2i."""
    return wp.array(np.array(values, np.uint16 if dtype == wp.uint16 else np.int32), dtype=dtype, device="cpu")


@cache
def block_table() -> BlockTable:
    """Return the table of all blocks of up to MAX_BISECTIONS, which kernels/refine/block.py copies.

    `code` has the states of all leaves, `leg` the positions of all new vertices in fractions of the two legs, in the
    order of the curve. Entry STATES * bisections + state of `first_leaf`, `first_vertex` and `vertices` (their number)
    locates those of one block.
    """
    all_leaves: list[int] = []
    all_vertices: list[tuple[int, int]] = []
    first_leaf, first_vertex, vertex_counts = [], [], []
    for bisections in range(MAX_BISECTIONS + 1):
        for state in range(STATES):
            leaves, vertices = bisected_states(state, bisections)
            first_leaf.append(len(all_leaves))
            first_vertex.append(len(all_vertices))
            vertex_counts.append(len(vertices))
            all_leaves += leaves
            all_vertices += vertices
    table = BlockTable()
    table.first_leaf, table.first_vertex = _array(first_leaf, wp.int32), _array(first_vertex, wp.int32)
    table.vertices = _array(vertex_counts, wp.int32)
    table.code, table.leg = _array(all_leaves, wp.uint16), _array(all_vertices, wp.vec2i)
    return table
