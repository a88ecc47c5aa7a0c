# SPDX-License-Identifier: GPL-3.0-or-later
"""Joining welded slices: what each import stands for, found slice by slice, and put in its place."""

import warp as wp

from .weld import (
    END_FIXES,
    END_FRONT,
    END_IMPORTS,
    END_POPS,
    END_RESTARTED,
    END_TOPS,
    ENDS,
    FRONT,
    SIDE,
    STACK,
    UPPER_LEFT,
    Weld,
)

wp.set_module_options({"enable_backward": False})


@wp.func
def settle(number: wp.int32, base: wp.int32, found: wp.array(dtype=wp.vec2i), of: wp.int32) -> wp.int32:
    """The number itself, or the edge (of = 0) or vertex (of = 1) that an import stands for."""
    n = number
    if number < 0:
        n = found[base - 1 - number][of]
    return n


@wp.struct
class Slices:
    """All slices of one welding, for the serial pass that joins them."""

    count: wp.int32
    rows: wp.array(dtype=wp.vec4i)  # per slice: its square, base of stacks, size of a stack, base of imports
    starts: wp.array(dtype=wp.int32)  # per slice: 1 if its first leaf is its square's first
    joined: wp.array(dtype=wp.vec2i)  # two stacks of joined_size: all that is open at the end of a slice
    joined_size: wp.int32
    found: wp.array(dtype=wp.vec2i)  # per import: (edge, vertex)


@wp.kernel
def resolve(s: Slices, w: Weld):
    """Find what each import stands for, slice by slice, and settle what later slices will ask for."""
    top0 = wp.int32(0)
    top1 = wp.int32(0)
    for k in range(s.count):
        e = ENDS * k
        square = s.rows[k][0]
        stack = s.rows[k][1]
        size = s.rows[k][2]
        base = s.rows[k][3]
        for i in range(w.ends[e + END_IMPORTS]):
            kind = w.imports[base + i][0]
            value = w.imports[base + i][1]
            number = wp.vec2i(0, 0)
            if kind == FRONT:
                n = w.ends[e - ENDS + END_FRONT + value]
                number = wp.vec2i(n, n)
            elif kind == STACK:
                number = s.joined[top0 - 1 - value]
            elif kind == STACK + 1:
                number = s.joined[s.joined_size + top1 - 1 - value]
            elif kind == SIDE:
                number = w.side[value]
            elif kind == UPPER_LEFT:
                number = wp.vec2i(0, w.corners[2 * value])
            else:
                number = wp.vec2i(0, w.corners[2 * value + 1])
            s.found[base + i] = number
        w.ends[e + END_FRONT] = settle(w.ends[e + END_FRONT], base, s.found, 1)
        w.ends[e + END_FRONT + 1] = settle(w.ends[e + END_FRONT + 1], base, s.found, 1)
        if w.ends[e + END_RESTARTED] == 1:
            top0 = 0
            top1 = 0
        else:
            top0 -= w.ends[e + END_POPS]
            top1 -= w.ends[e + END_POPS + 1]
        for i in range(w.ends[e + END_TOPS]):
            open_edge = w.stack[stack + i]
            s.joined[top0] = wp.vec2i(open_edge[0], settle(open_edge[1], base, s.found, 1))
            top0 += 1
        for i in range(w.ends[e + END_TOPS + 1]):
            open_edge = w.stack[stack + size + i]
            s.joined[s.joined_size + top1] = wp.vec2i(open_edge[0], settle(open_edge[1], base, s.found, 1))
            top1 += 1
        # The sides and corners that this slice has written: up to where the next one begins.
        last = w.columns * w.rows - 1
        if k + 1 < s.count:
            last = s.rows[k + 1][0]
        for q in range(square, last + 1):
            right = w.right_base[q]
            above = w.above_base[q]
            right_end = w.right_base[q + 1]
            above_end = w.above_base[q + 1]
            if k + 1 < s.count and q == last:
                right_end = right + w.before[4 * (k + 1) + 2]
                above_end = above + w.before[4 * (k + 1) + 3]
            own = wp.int32(1)
            if q == square:
                right += w.before[4 * k + 2]
                above += w.before[4 * k + 3]
                own = s.starts[k]
            if k + 1 < s.count and q == last and s.starts[k + 1] == 1:
                own = 0
            for i in range(right, right_end):
                w.side[i] = wp.vec2i(w.side[i][0], settle(w.side[i][1], base, s.found, 1))
            for i in range(above, above_end):
                w.side[i] = wp.vec2i(w.side[i][0], settle(w.side[i][1], base, s.found, 1))
            if own == 1:
                w.corners[2 * q] = settle(w.corners[2 * q], base, s.found, 1)


@wp.kernel
def patch(w: Weld, found: wp.array(dtype=wp.vec2i)):
    """Put what was found in the place of the slice's negative numbers."""
    for i in range(w.ends[ENDS * w.slot + END_FIXES]):
        f = w.fixes[w.fix_base + i]
        b = w.import_base
        if f < 0:
            ends = w.edges[-1 - f]
            w.edges[-1 - f] = wp.vec2i(settle(ends[0], b, found, 1), settle(ends[1], b, found, 1))
        else:
            for c in range(3 * f, 3 * f + 3):
                w.corner_verts[c] = settle(w.corner_verts[c], b, found, 1)
                w.corner_edges[c] = settle(w.corner_edges[c], b, found, 0)
