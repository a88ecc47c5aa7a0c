# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of what bisections make of a triangle in each state of the curve, for the walk to copy from."""

from functools import cache

import numpy as np
import warp as wp

from ...kernels.refine import curve
from ...kernels.refine.block import MAX_BISECTIONS, Blocks
from ...kernels.refine.shape import LEAVES, MAX_SHAPE, Shapes

STATES = 6
# Of the children, off the leftmost spine of the tree (left_state and right_state in kernels/refine/curve.py).
LEFT_STATE, RIGHT_STATE = (2, 3, 0, 1, 2, 2), (4, 5, 5, 5, 0, 1)


def bisected(state: int, unit: int, splits) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """State and depth of each leaf below a triangle, in the order of the curve, and where its new vertices are.

    splits(depth, number) says which descendants are split, numbered at each depth along the curve. Vertices count from
    the apex, in `unit`-ths of the legs towards left and right.
    """
    leaves, legs = [], []

    def walk(left, apex, right, state: int, depth: int, number: int) -> None:
        if not splits(depth, number):
            leaves.append((state, depth))
            if state % 2 == 0:  # its third edge is new, and so is the end of it
                legs.append(apex if state == curve.HYP_LEG else right)
            return
        middle = tuple((a + b) // 2 for a, b in zip(left, right, strict=True))
        walk(left, middle, apex, LEFT_STATE[state], depth + 1, 2 * number)
        walk(apex, middle, right, RIGHT_STATE[state], depth + 1, 2 * number + 1)

    walk((unit, 0), (0, 0), (0, unit), state, 0, 0)
    return leaves, legs


def _array(values, dtype) -> wp.array:
    return wp.array(np.array(values, np.uint16 if dtype == wp.uint16 else np.int32), dtype=dtype, device="cpu")


@cache
def blocks() -> Blocks:
    """What n even bisections make of a triangle: see kernels/refine/block.py."""
    codes, legs, first_leaf, first_vertex, vertices = [], [], [], [], []
    for n in range(MAX_BISECTIONS + 1):
        for state in range(STATES):
            leaves, new = bisected(state, 1 << ((n + 1) // 2), lambda depth, _number, n=n: depth < n)
            first_leaf.append(len(codes))
            first_vertex.append(len(legs))
            vertices.append(len(new))
            codes += [state for state, _depth in leaves]
            legs += new
    table = Blocks()
    table.first_leaf, table.first_vertex = _array(first_leaf, wp.int32), _array(first_vertex, wp.int32)
    table.vertices = _array(vertices, wp.int32)
    table.code, table.leg = _array(codes, wp.uint16), _array(legs, wp.vec2i)
    return table


@cache
def shapes() -> Shapes:
    """What up to three uneven bisections make of one: see kernels/refine/shape.py."""
    count = 64 * STATES
    leaves, vertices, starts = (np.zeros(count, np.int32) for _ in range(3))
    code, leg = np.zeros((count, LEAVES), np.uint16), np.zeros((count, LEAVES, 2), np.int32)
    for shape in range(64):
        for state in range(STATES):
            found, new = bisected(state, 4, lambda depth, number, shape=shape: _splits(shape, depth, number))
            entry = STATES * shape + state
            leaves[entry], vertices[entry] = len(found), len(new)
            begins = np.cumsum([0, *(1 << MAX_SHAPE - depth for _, depth in found[:-1])])
            starts[entry] = np.bitwise_or.reduce(1 << begins)
            words = [of | (depth & 1) << curve.PARITY | depth << curve.DEPTH_SHIFT for of, depth in found]
            code[entry, : len(found)], leg[entry, : len(new)] = words, np.array(new).reshape(-1, 2)
    table = Shapes()
    table.leaves, table.vertices, table.starts = (_array(values, wp.int32) for values in (leaves, vertices, starts))
    table.code, table.leg = _array(code.reshape(-1), wp.uint16), _array(leg.reshape(-1, 2), wp.vec2i)
    return table


def _splits(shape: int, depth: int, number: int) -> bool:
    """Whether the shape bisects the `number`-th triangle of a depth below its own."""
    bit = (1 << depth) - 2 + number
    return depth == 0 or (depth < MAX_SHAPE and bool(shape >> bit & 1))
