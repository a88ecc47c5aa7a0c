# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that are raised so that the next walk splits a diamond; they stay nested.

The *walk* refines from the root triangles and splits each diamond whose stored error is too large. Errors are codes,
one byte a diamond, which grow with their logarithm. They are nested if no diamond has a larger one than its parents. A
root square of the domain d has 2^levels cells and 2^unit_bits lattice units a side.
"""

import warp as wp

from ..field.domain import Domain
from ..field.layout import tile_index
from ..morph.lattice import half_edge
from ..refine.stored_errors import error_index
from ..unchecked import item_at, put

# Codes of errors while a mesh without finer tiles is fitted: PER_OCTAVE in an octave. A diamond with RAISED, twice the
# requested error, is split. The first code stands for an eighth of that error.
PER_OCTAVE = 16
RAISED = 1 + 4 * 16
# Largest `halvings` of `raise_cells`: its highest code is 225 then, and a code is at most 255.
MAX_HALVINGS = 5
# PER_OCTAVE with finer tiles: smaller, so that there are codes for as many halvings as the depth of leaves requires.
FINER_PER_OCTAVE = 8


@wp.struct
class RaisedCodes:
    """The codes of errors that splits raise."""

    per_octave: wp.int32  # codes in an octave
    split: wp.int32  # code of twice the requested error; a diamond with it is split
    more: wp.int32  # further steps from cell to cell that `raise_cells` goes; 0 without finer tiles


@wp.func
def entry_of(d: Domain, x: wp.int32, y: wp.int32, depth: wp.int32) -> wp.int64:
    """Return the entry in the array of errors of the diamond at `depth` that is split at (x, y), lattice units.

    It is that of the raster's cell for a diamond inside one. Entries of cells begin at d.cell_base and are in pages,
    d.cell_pages of them in a row (`tile_index`).
    """
    entry = d.cell_base
    if depth <= 2 * d.levels:  # not finer than cells
        entry = error_index(d, x, y, depth)
    else:
        bits = d.unit_bits - d.levels
        i = wp.min(x >> bits, d.cell_columns - 1)
        j = wp.min(y >> bits, d.cell_rows - 1)
        entry = entry + tile_index(i, j, d.cell_pages)
    return entry


@wp.func
def raise_ancestors(
    d: Domain,
    x: wp.int32,
    y: wp.int32,
    depth: wp.int32,
    code: wp.int32,
    codes: wp.array(dtype=wp.uint8),
    stack: wp.array(dtype=wp.vec3i),
):
    """Raise the error codes of the diamond split at (x, y) and all its ancestors to `code`, so that errors stay nested.

    A diamond's parents are those that are split at the apexes of its two triangles. An ancestor that has the code
    already ends the ascent: those above it have it, too. depth: of the diamond, at most that of the raster's cells.
    codes: of the errors of all diamonds. stack: scratch.
    """
    top = wp.int32(1)
    stack[0] = wp.vec3i(x, y, depth)
    while top > 0:
        top -= 1
        diamond = stack[top]
        entry = entry_of(d, diamond[0], diamond[1], diamond[2])
        if wp.int32(item_at(codes, entry)) < code:
            put(codes, entry, wp.uint8(code))
            if diamond[2] > 1:  # it has parents
                along = half_edge(d.unit_bits, wp.vec2i(diamond[0], diamond[1]), diamond[2])
                for k in range(2):  # an apex is as far on either side of the edge
                    px = wp.where(k == 0, diamond[0] + along[1], diamond[0] - along[1])
                    py = wp.where(k == 0, diamond[1] - along[0], diamond[1] + along[0])
                    inside = px >= 0 and py >= 0
                    if inside and px <= (d.columns << d.unit_bits) and py <= (d.rows << d.unit_bits):
                        stack[top] = wp.vec3i(px, py, diamond[2] - 1)
                        top += 1


@wp.func
def raise_cells(
    d: Domain,
    i: wp.int32,
    j: wp.int32,
    halvings: wp.int32,
    raised: RaisedCodes,
    codes: wp.array(dtype=wp.uint8),
    stack: wp.array(dtype=wp.vec3i),
):
    """Raise the codes of cell (i, j) and cells around it: triangles in it are split even after `halvings` of its sides.

    The error of a cell's triangles falls to a quarter with each halving of their sides, so the code of the cell itself
    is 2 octaves higher for each. A cell's error is at least a quarter of that of each neighbour: codes fall by 2
    octaves a step, down to one step beyond the last cells with the code of a split. With finer tiles, whose change is
    added to errors, they go on falling for `raised.more` steps. raised.split: code of an error that is certainly split;
    raised.per_octave: codes in an octave. halvings: at most MAX_HALVINGS. codes: of the errors of all diamonds. stack:
    scratch.
    """
    bits = d.unit_bits - d.levels
    reach = halvings + 1 + raised.more
    for b in range(-reach, reach + 1):
        for a in range(-reach, reach + 1):
            steps_left = reach - wp.abs(a) - wp.abs(b)
            inside = i + a >= 0 and j + b >= 0 and i + a < d.cell_columns and j + b < d.cell_rows
            if steps_left >= 0 and inside:
                x = ((i + a) << bits) + (1 << (bits - 1))
                y = ((j + b) << bits) + (1 << (bits - 1))  # the cell's middle, at depth 2 * levels + 1
                # The code of splits with 1 + raised.more steps left; two octaves, a factor of four, more or less for
                # each other number of steps.
                code = raised.split + (steps_left - 1 - raised.more) * 2 * raised.per_octave
                raise_ancestors(d, x, y, 2 * d.levels + 1, code, codes, stack)
