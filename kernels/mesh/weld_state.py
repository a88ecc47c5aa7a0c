# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the slices of a welding: arrays, first numbers and the list of imports.

An import is a vertex or edge that an earlier slice made. Until join.py resolves it, it has the negative number -1 - i,
where i is its index in the slice's list. `b`: the slice's first numbers. `first_state`: its first entry in `state`.

The triangles that are welded so far form a strip along the curve. An edge of its left or right border of which only one
triangle is known is open: it is on the border's stack. The front is the edge by which the curve enters the next leaf.
An edge's level is the depth of triangles whose longest edge it is.
"""

import warp as wp

# Kinds of imports; STACK and SIDE hold the edge's level above these LEVEL_SHIFT bits.
LEVEL_SHIFT = wp.constant(3)
FRONT = wp.constant(0)  # value 0, 1: that vertex of the front, 2: its edge
STACK = wp.constant(1)  # + side (1 or 2): the value-th edge from the top of the stack
SIDE = wp.constant(3)  # entry `value` of the shared sides
UPPER_LEFT = wp.constant(4)  # upper left corner of square `value`
UPPER_RIGHT = wp.constant(5)

# Columns of a slice's state, a row of STATE_SIZE entries.
IMPORTS, FIXES = wp.constant(0), wp.constant(1)  # lengths of these two lists
POPS = wp.constant(2)  # of each side, edges taken from earlier slices' stacks
SQUARE = wp.constant(4)  # number of the current square
LEFT, BELOW, RIGHT, ABOVE = wp.constant(5), wp.constant(6), wp.constant(7), wp.constant(8)  # edges of its sides passed
FIRST_BEGUN = wp.constant(9)  # the first square that began in this slice, which made its upper left corner
RESTARTED = wp.constant(10)  # 1: a square began in the slice, so edges left open before are not needed
END_FRONT, END_TOPS = wp.constant(11), wp.constant(14)  # at the end: 3 numbers of the front, lengths of both stacks
TORN = wp.constant(16)  # 1: an edge met one of another level, so the leaves do not fit together
FIRST_LEVEL, LAST_LEVEL = wp.constant(17), wp.constant(18)  # of the edges of entry and leave; 0 at a square's ends
STATE_SIZE = wp.constant(20)
SPARE = wp.constant(8)  # entries of a slice's lists beyond one a leaf


@wp.struct
class Weld:
    """Input and output arrays of all slices."""

    columns: wp.int32
    rows: wp.int32
    counts: wp.array(dtype=wp.int64)  # [slices, 3]: leaves, vertices, edges of each
    leaf_base: wp.array(dtype=wp.int64)  # [slices]: first entry in `code`
    squares: wp.array(dtype=wp.int32)  # [slices]: where each begins
    before: wp.array(dtype=wp.int32)  # [slices, 4]: edges of that square's sides passed by earlier slices
    side_base: wp.array(dtype=wp.int32)  # first entry of every square's right side in `side`, then of upper sides, end
    code: wp.array(dtype=wp.uint16)  # words of leaves, see kernels/refine/curve.py
    side: wp.array(dtype=wp.vec2i)  # edges of the shared sides, each with the vertex where it was begun
    side_level: wp.array(dtype=wp.int32)  # ... and its level
    corners: wp.array(dtype=wp.int32)  # per square: upper left and upper right vertex
    stack: wp.array(dtype=wp.vec2i)  # open edges of both borders, each with the vertex where it was begun
    stack_level: wp.array(dtype=wp.int32)  # ... and its level
    imports: wp.array(dtype=wp.vec2i)  # (kind, value)
    fixes: wp.array(dtype=wp.int32)  # triangles with a number that is an import
    state: wp.array(dtype=wp.int32)  # [slices, STATE_SIZE]
    corner_verts: wp.array(dtype=wp.int32)  # results: three of each triangle
    corner_edges: wp.array(dtype=wp.int32)
    edges: wp.array(dtype=wp.vec2i)
    level: wp.array(dtype=wp.int32)


@wp.struct
class Base:
    """The first numbers that a slice gives, and where its part of each list begins."""

    triangle: wp.int32
    vertex: wp.int32
    edge: wp.int32
    list_base: wp.int32  # its first entry in each list: one for every leaf before it, and SPARE for each slice before


@wp.struct
class Strip:
    """Front and next free numbers of a slice while it is welded along the curve."""

    front0: wp.int32  # the front's vertices
    front1: wp.int32
    entry: wp.int32  # ... and its edge
    level: wp.int32  # of that edge; 0: a square begins or has ended
    next0: wp.int32  # entries of `Weld.stack` for the next open edge of the left and of the right border
    next1: wp.int32
    edge: wp.int32  # the next new edge
    vertex: wp.int32
    torn: wp.int32  # not 0: a leaf has met an edge of another level


@wp.func
def base_of(counts: wp.array(dtype=wp.int64), slot: wp.int32) -> Base:
    """Return the first numbers of slice `slot`, and where its part of the lists begins.

    counts: leaves, vertices and edges of each slice; those of the slices before are added up.
    """
    b = Base()
    for s in range(slot):
        b.triangle += wp.int32(counts[3 * s])
        b.vertex += wp.int32(counts[3 * s + 1])
        b.edge += wp.int32(counts[3 * s + 2])
    b.list_base = b.triangle + SPARE * slot
    return b


@wp.func
def stack_base(list_base: wp.int32, leaves: wp.int32, side: wp.int32) -> wp.int32:
    """Return the first entry of a slice's stack of open edges for a side (0 left, 1 right); a spare entry is below it.

    The array of stacks has two entries for each one of a list. list_base: first entry of the slice in each list.
    leaves: number of the slice's leaves.
    """
    return 2 * list_base + 1 + side * (leaves + 2)


@wp.func
def add_import(w: Weld, b: Base, first_state: wp.int32, kind: wp.int32, value: wp.int32) -> wp.int32:
    """Add an import of a kind (FRONT ..) to the slice's list; return the negative number that stands for it.

    first_state: the slice's first entry in `w.state`. kind: of STACK and SIDE, with the edge's level above LEVEL_SHIFT
    bits. value: which one of its kind, see the kinds above.
    """
    n = w.state[first_state + IMPORTS]
    w.imports[2 * b.list_base + n] = wp.vec2i(kind, value)
    w.state[first_state + IMPORTS] = n + 1
    return -1 - n


@wp.func
def import_open_edge(w: Weld, b: Base, first_state: wp.int32, side: wp.int32, level: wp.int32) -> wp.int32:
    """Import the next edge from the stack that earlier slices left open on a side; return its negative number.

    The number also stands for the vertex where the edge was begun. first_state: the slice's first entry in `w.state`.
    level: the edge's level, which is checked later, by `join`.
    """
    n = w.state[first_state + POPS + side]
    w.state[first_state + POPS + side] = n + 1
    return add_import(w, b, first_state, (STACK + side) | (level << LEVEL_SHIFT), n)


@wp.func
def check_level(w: Weld, first_state: wp.int32, level: wp.int32, other: wp.int32):
    """Mark the slice as torn if the two leaves of an edge give it different levels: errors are not nested then.

    first_state: the slice's first entry in `w.state`. level, other: the edge's level as each of them has it.
    """
    if level != other:
        w.state[first_state + TORN] = 1
