# SPDX-License-Identifier: GPL-3.0-or-later
"""What the slices of a welding keep: their arrays, their numbers and the list of what they ask of each other.

What a slice needs from earlier ones is an import: it gets the negative number -1 - i, i being its place in the slice's
list; join.py finds what each stands for.
"""

import warp as wp

# What an import asks for; above these LEVEL_SHIFT bits is the edge's level, of STACK and SIDE.
LEVEL_SHIFT = wp.constant(3)
FRONT = wp.constant(0)  # value 0, 1: that vertex of the front, 2: its edge
STACK = wp.constant(1)  # + side (1 or 2): the value-th edge from the top of the stack
SIDE = wp.constant(3)  # entry `value` of the shared sides
UPPER_LEFT = wp.constant(4)  # upper left corner of square `value`
UPPER_RIGHT = wp.constant(5)

# Columns of a slice's state: what changes too rarely to be kept at hand, and what the slice leaves to the next.
IMPORTS, FIXES = wp.constant(0), wp.constant(1)
POPS = wp.constant(2)  # of each side, edges taken from earlier slices' stacks
SQUARE = wp.constant(4)
LEFT, BELOW, RIGHT, ABOVE = wp.constant(5), wp.constant(6), wp.constant(7), wp.constant(8)  # edges of its sides passed
FIRST_OWN = wp.constant(9)  # the first square of which this slice has made the upper left corner
RESTARTED = wp.constant(10)  # 1: a square began in the slice, so what was open before it is not needed
END_FRONT, END_TOPS = wp.constant(11), wp.constant(14)
TORN = wp.constant(16)  # 1: an edge met one of another level, so the leaves do not fit together
FIRST_LEVEL, LAST_LEVEL = wp.constant(17), wp.constant(18)  # of the edges of entry and leave; 0 at a square's ends
STATE_SIZE = wp.constant(20)
SPARE = wp.constant(8)  # entries of a slice's lists beyond one a leaf


@wp.struct
class Weld:
    """What the slices read and write; the numbers of slices and squares are in its arrays."""

    columns: wp.int32
    rows: wp.int32
    counts: wp.array(dtype=wp.int64)  # [slices, 3]: leaves, vertices, edges of each
    leaf_base: wp.array(dtype=wp.int64)  # [slices]: first entry in `code`
    squares: wp.array(dtype=wp.int32)  # [slices]: where each begins
    before: wp.array(dtype=wp.int32)  # [slices, 4]: edges of that square's sides passed by earlier slices
    side_base: wp.array(dtype=wp.int32)  # first entry of every square's right side in `side`, then of upper sides, end
    code: wp.array(dtype=wp.uint16)
    side: wp.array(dtype=wp.vec2i)  # edges of the shared sides, each with the vertex where it was begun
    side_level: wp.array(dtype=wp.int32)  # ... and its level
    corners: wp.array(dtype=wp.int32)  # per square: upper left and upper right vertex
    stack: wp.array(dtype=wp.vec2i)
    stack_level: wp.array(dtype=wp.int32)  # of each open edge
    imports: wp.array(dtype=wp.vec2i)
    fixes: wp.array(dtype=wp.int32)  # triangles with a number that is an import
    state: wp.array(dtype=wp.int32)  # [slices, STATE_SIZE]
    corner_verts: wp.array(dtype=wp.int32)
    corner_edges: wp.array(dtype=wp.int32)
    edges: wp.array(dtype=wp.vec2i)
    level: wp.array(dtype=wp.int32)


@wp.struct
class Base:
    """Where a slice's numbers and its share of the lists begin."""

    triangle: wp.int32
    vertex: wp.int32
    edge: wp.int32
    room: wp.int32  # of each list: a place for every leaf before it, and some


@wp.struct
class Strip:
    """Where a slice stands on its way along the curve."""

    front0: wp.int32  # the front's vertices
    front1: wp.int32
    entry: wp.int32  # ... and its edge
    level: wp.int32  # of that edge; 0: a square begins or has ended
    next0: wp.int32  # places of the next open edges of the two stacks
    next1: wp.int32
    edge: wp.int32  # the next new edge
    vertex: wp.int32
    torn: wp.int32  # not 0: a leaf has met an edge of another level


@wp.func
def base_of(counts: wp.array(dtype=wp.int64), slot: wp.int32) -> Base:
    b = Base()
    for s in range(slot):
        b.triangle += wp.int32(counts[3 * s])
        b.vertex += wp.int32(counts[3 * s + 1])
        b.edge += wp.int32(counts[3 * s + 2])
    b.room = b.triangle + SPARE * slot
    return b


@wp.func
def stack_base(room: wp.int32, leaves: wp.int32, side: wp.int32) -> wp.int32:
    """Two stacks a slice, each with an entry to spare below its first."""
    return 2 * room + 1 + side * (leaves + 2)


@wp.func
def ask(w: Weld, b: Base, e: wp.int32, kind: wp.int32, value: wp.int32) -> wp.int32:
    """Write an import and return the number that stands for it."""
    n = w.state[e + IMPORTS]
    w.imports[2 * b.room + n] = wp.vec2i(kind, value)
    w.state[e + IMPORTS] = n + 1
    return -1 - n


@wp.func
def ask_stack(w: Weld, b: Base, e: wp.int32, side: wp.int32, level: wp.int32) -> wp.int32:
    """The next edge, of this level, from the top of what earlier slices have left open on a side."""
    n = w.state[e + POPS + side]
    w.state[e + POPS + side] = n + 1
    return ask(w, b, e, (STACK + side) | (level << LEVEL_SHIFT), n)


@wp.func
def meet(w: Weld, e: wp.int32, level: wp.int32, other: wp.int32):
    """An edge of two leaves has one level. Levels differ only where errors are not nested: then the mesh is torn."""
    if level != other:
        w.state[e + TORN] = 1
