# SPDX-License-Identifier: GPL-3.0-or-later
"""State of a leaf count, and the last relaxation step at which a diamond is split.

A step loosens the criterion by a fixed factor: the larger a step, the fewer diamonds are split. `w`: the slice's Count.
"""

import warp as wp

from ..refine.diamond import larger, smaller
from ..refine.interval import Limits, LodInterval, MeasuredDiamond, excess2, too_coarse
from ..refine.pixels import CriterionArrays

CELLS = wp.constant(128)  # entries of a slice's stack: three for every second level are enough
STEPS_PER_OCTAVE = 128
# Squared limits are 2^(1/64) apart: a step changes the number of triangles by about a hundredth.
STEPS_PER_SQUARE = wp.constant(wp.float64(STEPS_PER_OCTAVE / 2))
MARKS = wp.constant(256)  # cells that a slice notes, at equal numbers of measured diamonds


@wp.struct
class Cell:
    """A cell whose diamond is split."""

    x: wp.int32  # its middle, lattice units
    y: wp.int32
    depth: wp.int32  # of the diamond
    code: wp.uint64  # its first deepest cell, all squares in a row
    interval: LodInterval  # certain at all steps that are counted


@wp.struct
class CellDiamond:
    """A diamond of a cell."""

    number: wp.int32  # 3 .. 0: quadrants of the cell; -1, -2, -3, -4: its south, west, north and east side
    x: wp.int32  # where it is split, lattice units
    y: wp.int32
    depth: wp.int32
    code: wp.uint64  # its first deepest cell
    half: wp.int32  # of a quadrant: half its side, lattice units
    triangles: wp.int32  # number of its triangles that count in this cell, 0 .. 2


@wp.struct
class Count:
    """A slice's part of the quadtree, its range of steps, and the arrays of the count."""

    first_cell: wp.uint64  # slice [first_cell, end_cell) of deepest cells, all squares in a row
    end_cell: wp.uint64
    cell_bits: wp.int32  # deepest cells in a square: 2**cell_bits
    max_depth: wp.int32
    has_errors: wp.int32  # 0: the criterion does not depend on errors
    slot: wp.int32  # number of the slice
    finest: wp.int32  # first step to count
    coarsest: wp.int32  # last step
    max_splits: wp.int64  # steps at which more triangles than this are split need no count
    spacing: wp.int64  # measured diamonds from mark to mark
    limit_factors: wp.array(dtype=wp.float64)  # per step: factor on the squared limits of the criterion
    stack: wp.array(dtype=Cell)
    last_steps: wp.array(dtype=wp.int64)  # per slice and step: triangles that are split for the last time at it
    from_step: wp.array(dtype=wp.int32)  # per slice: first step with a valid count; more than `coarsest`: none
    marks: wp.array(dtype=wp.uint64)  # per slice: cells, see MARKS
    measured: wp.array(dtype=wp.int64)  # per slice: diamonds


@wp.func
def count_last_split(w: Count, step: wp.int32, last: wp.int32, triangles: wp.int64) -> wp.int64:
    """Count triangles that are split at the steps up to `last`; return how many of them are split at `step`.

    All of them are, and w.last_steps counts them at `last`; if `last` is before `step`, none is and none is counted.
    """
    counted = wp.int64(0)
    if last >= step:
        entry = w.slot * w.limit_factors.shape[0] + last
        w.last_steps[entry] = w.last_steps[entry] + triangles
        counted = triangles
    return counted


@wp.func
def last_split(criterion: CriterionArrays, limits: Limits, w: Count, first: wp.int32, m: MeasuredDiamond) -> wp.int32:
    """Return the last step at which the measured diamond m is split. It is split at step `first`.

    limits: the criterion at `first`. The logarithm of the diamond's squared excess over it, at STEPS_PER_SQUARE an
    octave, estimates the number of steps from `first` on, limited to 0 .. w.coarsest - first (also for NaN). The walk's
    test `too_coarse` then finds the exact one.
    """
    num_steps = wp.float64(wp.log2(wp.float32(excess2(limits, m)))) * STEPS_PER_SQUARE
    step = first + wp.int32(larger(smaller(num_steps, wp.float64(w.coarsest - first)), wp.float64(0.0)))
    while step < w.coarsest and too_coarse(criterion, w.limit_factors[step + 1], m):
        step += 1
    while step > first and not too_coarse(criterion, w.limit_factors[step], m):
        step -= 1
    return step
