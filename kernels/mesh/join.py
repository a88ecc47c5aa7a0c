# SPDX-License-Identifier: GPL-3.0-or-later
"""Joining of welded slices: each import is resolved, slice by slice, and replaced by its number.

An import is a vertex or an edge that an earlier slice has made; until it is resolved it has a negative number. It comes
from one of three places: the front (the edge by which the curve enters the slice), one of two stacks of open edges (of
which only one triangle is known yet, left and right of the curve), or the sides and corners that root squares share. A
slice whose two leaves at an edge give it different levels is marked TORN. `w`: the arrays of all slices. An edge's
level is the depth of triangles whose longest edge it is. Capital names after `first_state` or STATE_SIZE are columns
of `w.state`, which has STATE_SIZE entries for each slice; those that begin with END describe the end of a slice.

An entry of `w.imports` is (kind, value). The kinds STACK (and + 1, the right border's) and SIDE have the edge's level
in their upper bits. The value is a number of the front (0 and 1: its vertices, 2: the edge), a number of entries below
the top of the stack, the entry in `w.side`, or the square.
"""

import warp as wp

from .weld_state import (
    END_FRONT,
    END_TOPS,
    FIRST_BEGUN,
    FIXES,
    FRONT,
    IMPORTS,
    LEVEL_SHIFT,
    POPS,
    RESTARTED,
    SIDE,
    STACK,
    STATE_SIZE,
    TORN,
    UPPER_LEFT,
    Weld,
    base_of,
    check_level,
    stack_base,
)


@wp.func
def resolve_number(number: wp.int32, first: wp.int32, found: wp.array(dtype=wp.vec2i), is_vertex: wp.int32) -> wp.int32:
    """Return the edge or vertex of an earlier slice that an import, a negative number, stands for.

    Other numbers stay as they are. first: index of the slice's first import. found: (edge, vertex) of each import.
    is_vertex: 1 for the vertex, 0 for the edge.
    """
    resolved = number
    if number < 0:
        resolved = found[first - 1 - number][is_vertex]
    return resolved


@wp.func
def resolve(
    slices: wp.int32,
    size: wp.int32,
    w: Weld,
    open: wp.array(dtype=wp.vec2i),
    open_level: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.vec2i),
):
    """Write the (edge, vertex) of an earlier slice that each import stands for to `found`, slice by slice.

    It also completes the entries of shared sides that later slices import, and marks slices as TORN whose triangles do
    not fit together. slices: number of slices. open, open_level: scratch for two stacks of `size` entries: the edges
    that are open at the end of a slice, each as (edge, vertex where it begins), and their levels.
    """
    squares = w.columns * w.rows
    tops = wp.vec2i(0, 0)
    for k in range(slices):
        first_state = STATE_SIZE * k
        leaves = wp.int32(w.counts[3 * k])
        list_base = base_of(w.counts, k).list_base
        first = 2 * list_base  # of the slice's imports; their list has two entries for each one of other lists
        # What each import stands for.
        for i in range(w.state[first_state + IMPORTS]):
            level = w.imports[first + i][0] >> LEVEL_SHIFT
            kind = w.imports[first + i][0] & ((1 << LEVEL_SHIFT) - 1)
            value = w.imports[first + i][1]
            element = wp.vec2i(0, 0)
            if kind == FRONT:
                n = w.state[first_state - STATE_SIZE + END_FRONT + value]
                # A front's import is used either as a vertex or as the edge.
                element = wp.vec2i(n, n)
            elif kind == STACK or kind == STACK + 1:
                entry = tops[kind - STACK] - 1 - value
                if entry < 0:  # nothing is open
                    w.state[first_state + TORN] = 1
                else:
                    entry += (kind - STACK) * size
                    element = open[entry]
                    check_level(w, first_state, level, open_level[entry])
            elif kind == SIDE:
                element = w.side[value]
                check_level(w, first_state, level, w.side_level[value])
            elif kind == UPPER_LEFT:
                element = wp.vec2i(0, w.corners[2 * value])
            else:  # UPPER_RIGHT
                element = wp.vec2i(0, w.corners[2 * value + 1])
            found[first + i] = element
        # The front and the open edges at the end of this slice.
        w.state[first_state + END_FRONT] = resolve_number(w.state[first_state + END_FRONT], first, found, 1)
        w.state[first_state + END_FRONT + 1] = resolve_number(w.state[first_state + END_FRONT + 1], first, found, 1)
        for side in range(2):
            top = wp.max(tops[side] - w.state[first_state + POPS + side], 0)
            if w.state[first_state + RESTARTED] == 1:  # a square began here, so no edge before is open
                top = 0
            for i in range(w.state[first_state + END_TOPS + side]):
                entry = stack_base(list_base, leaves, side) + i
                edge = w.stack[entry]
                open_level[side * size + top] = w.stack_level[entry]
                open[side * size + top] = wp.vec2i(edge[0], resolve_number(edge[1], first, found, 1))
                top += 1
            tops[side] = top
        # The sides and corners that this slice has written: up to where the next one begins.
        last = squares
        if k + 1 < slices:
            last = w.squares[k + 1]
        for q in range(w.squares[k], wp.min(last + 1, squares)):
            for upper in range(2):  # 0: the right side, 1: the upper side; columns 2 and 3 of `before`
                begin = w.side_base[upper * squares + q]
                end = w.side_base[upper * squares + q + 1]
                if q == last:  # the next slice has made the rest
                    end = begin + w.before[4 * (k + 1) + 2 + upper]
                if q == w.squares[k]:  # earlier slices have made the first edges
                    begin += w.before[4 * k + 2 + upper]
                for i in range(begin, end):
                    w.side[i] = wp.vec2i(w.side[i][0], resolve_number(w.side[i][1], first, found, 1))
            # The square began in this slice.
            if q >= w.state[first_state + FIRST_BEGUN] and (
                k + 1 == slices or q < w.state[first_state + STATE_SIZE + FIRST_BEGUN]
            ):
                w.corners[2 * q] = resolve_number(w.corners[2 * q], first, found, 1)


@wp.func
def replace_imports(slot: wp.int32, w: Weld, found: wp.array(dtype=wp.vec2i)):
    """Replace the imports (negative numbers) in a slice's triangles and edges by the elements that they stand for.

    slot: number of the slice. found: (edge, vertex) of each import of all slices. `w.fixes` lists the triangles that
    have imports.
    """
    list_base = base_of(w.counts, slot).list_base
    first_import = 2 * list_base  # the list of imports has two entries for each one of other lists
    for i in range(w.state[STATE_SIZE * slot + FIXES]):
        t = w.fixes[list_base + i]
        for c in range(3 * t, 3 * t + 3):
            edge = w.corner_edges[c]
            if edge >= 0:  # this slice made it, perhaps with imported ends
                ends = w.edges[edge]
                w.edges[edge] = wp.vec2i(
                    resolve_number(ends[0], first_import, found, 1), resolve_number(ends[1], first_import, found, 1)
                )
            w.corner_edges[c] = resolve_number(edge, first_import, found, 0)
            w.corner_verts[c] = resolve_number(w.corner_verts[c], first_import, found, 1)


@wp.kernel
def join(
    slices: wp.int32,
    size: wp.int32,
    w: Weld,
    open: wp.array(dtype=wp.vec2i),
    open_level: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.vec2i),
):
    """Join the welded slices by replacing imports, on one thread: they share few elements.

    slices: number of slices. open, open_level: scratch for two stacks of `size` entries, the edges that are open at the
    end of a slice and their levels. found: scratch for the (edge, vertex) of every import, indexed as `w.imports`.
    """
    resolve(slices, size, w, open, open_level, found)
    for k in range(slices):
        replace_imports(k, w, found)
