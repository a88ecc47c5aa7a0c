# SPDX-License-Identifier: GPL-3.0-or-later
"""Leaf counts of a refinement for several relaxation steps, in one pass that writes no leaf.

A criterion is nested in its relaxation, too: each diamond has a last step at which it is split, and it is split at all
steps before. Each split triangle adds one leaf. So the pass finds each diamond's last step and counts triangles by it.
Diamonds are judged as in the walk: by intervals, and by measuring those in doubt.

The pass follows the cells of a quadtree, not the curve. A diamond of odd depth fills a cell. One of even depth is
centred on the side between two cells and is counted in the northern or eastern one. So each is visited once, while a
walk over triangles visits it twice. For a window of few steps the pass takes about half the time of a refinement.

`w`: the slice's Count. A *slice* is a part of the curve through the deepest cells of the quadtree, those of
`max_depth`; a cell's `code` is the number of its first deepest cell on it. An *interval* (LodInterval) holds the
consequences of a measured diamond for those below it: stored errors above `split_above` metres are certainly split, and
errors up to `leaf_up_to` require no split. `first_cell` .. `end_cell` are the slice's deepest cells, and a root square
has 2^cell_bits of them. Steps end at `coarsest`; criterion.limit is the factor on its squared limits.
"""

import warp as wp

from ..field.domain import INLINED, Domain
from ..refine.interval import (
    DOUBT,
    SPLIT,
    Limits,
    interval_below,
    limits_of,
    measure_diamond,
    predict,
    too_coarse,
    unknown_interval,
)
from ..refine.pixels import CriterionArrays
from ..refine.stored_errors import SURE, error_at, fetch_ahead, leaves_tile, may_be_less, stored_error_at
from .count_state import CELLS, MARKS, Cell, CellDiamond, Count, count_last_split, last_split

wp.set_module_options(INLINED)


@wp.func
def square_cell(domain: Domain, w: Count, square: wp.int32) -> Cell:
    """Return a cell whose north-eastern quadrant is root square `square`: there the count of a square starts.

    Its middle is the square's south-western corner, and its code that of the square's first cell.
    """
    cell = Cell()
    row = square / domain.columns
    cell.x = (square - row * domain.columns) << domain.unit_bits
    cell.y = row << domain.unit_bits
    cell.depth = -1
    cell.code = wp.uint64(square) << wp.uint64(w.cell_bits)
    cell.interval = unknown_interval()
    return cell


@wp.func
def diamond_of_cell(domain: Domain, w: Count, cell: Cell, number: wp.int32) -> CellDiamond:
    """Return one of the eight diamonds that are counted in a cell.

    number: 3 .. 0 the quadrants of the cell, in this order so that quadrant 0 is on top of the stack; -1 and -2 its
    south and west side; -3 and -4 its north and east side, which count only on the terrain's border. `triangles` of the
    result is 0 if neither the diamond nor one below it is counted in this slice. A quadrant that begins in an earlier
    slice has 2, too, so that its cells in this slice are visited; its own diamond is counted where it begins, which
    `p.code < w.first_cell` tells the caller.
    """
    # Half of the cell's side, lattice units. Two bisections halve it; the start cell (depth -1) is two squares wide.
    half = (wp.int32(1) << domain.unit_bits) >> ((cell.depth + 1) >> 1)
    p = CellDiamond()
    p.number = number
    p.x = cell.x
    p.y = cell.y
    p.depth = cell.depth + 1
    p.code = cell.code
    size = wp.uint64(1) << wp.uint64(w.cell_bits - cell.depth - 1)  # deepest cells in a quadrant
    p.half = half >> 1  # of a quadrant's side
    p.triangles = 2
    if number >= 0:
        p.x += wp.where((number & 1) == 1, p.half, -p.half)
        p.y += wp.where((number & 2) == 2, p.half, -p.half)
        p.depth += 1
        if cell.depth > 0:  # otherwise it is that of `square_cell`, which begins where its quadrant does
            p.code += wp.uint64(number) * size
        if p.code + size <= w.first_cell or p.code >= w.end_cell:  # no part of it is in the slice
            p.triangles = 0
    else:
        if number == -1:
            p.y -= half
        elif number == -2:
            p.x -= half
        elif number == -3:
            p.y += half
        else:
            p.x += half
        # A diamond on the terrain's border has one triangle.
        if p.x == 0 or p.y == 0 or p.x == domain.columns << domain.unit_bits or p.y == domain.rows << domain.unit_bits:
            p.triangles = 1
        elif number < -2:  # the next cell counts it
            p.triangles = 0
        if p.code < w.first_cell:  # the cell begins in an earlier slice, which counts its sides
            p.triangles = 0
    return p


@wp.func
def judge(
    domain: Domain,
    criterion: CriterionArrays,
    limits: Limits,
    coarse: Limits,
    w: Count,
    cell: Cell,
    p: CellDiamond,
    top: wp.int32,
    step: wp.int32,
):
    """Return (last, visits, measured): the last step at which a diamond p is split, and how the count goes on below it.

    last: `step` - 1 if it is not split at `step`, the first step that still counts. visits: whether to visit the cell
    that it fills (a side fills none). measured: 1 if it had to be measured, else 0. limits, coarse: the criterion at
    `step` and at the last step. cell: that of `p`, with the interval that judges it. p.number: negative for a diamond
    on a side, below which this cell counts nothing. Below the raster's cells an error is SURE (a half) to 1 times the
    stored one, and computed exactly only for a measurement. The interval below the diamond is written into entry `top`
    of the stack. Plain numbers are returned because Warp copies a struct that changes in a branch, even if the branch
    is not taken.
    """
    error = wp.float32(0.0)
    min_fraction = wp.float64(1.0)  # of the stored error, that the exact one is at least
    if w.has_errors == 1:
        error = stored_error_at(domain, p.x, p.y, p.depth)
        if may_be_less(domain, p.depth):
            min_fraction = SURE
    error_m = wp.float64(error) * domain.error_scale
    verdict = predict(cell.interval, p.depth, min_fraction * error_m, error_m)
    last = step - 1
    visits = wp.bool(False)
    measured = wp.int32(0)
    w.stack[top].interval = cell.interval
    if verdict == SPLIT:
        last = w.coarsest
        visits = p.number >= 0
    # A diamond that is certainly split, though not by its error, is measured for a tighter interval below it.
    if verdict == DOUBT or (visits and error_m <= cell.interval.leaf_up_to):
        if min_fraction < wp.float64(1.0):
            error = error_at(domain, p.x, p.y, p.depth)
            error_m = wp.float64(error) * domain.error_scale
        m = measure_diamond(domain, criterion, p.x, p.y, p.depth, error, cell.interval.in_frame)
        measured = 1
        visits = wp.bool(False)
        if too_coarse(criterion, criterion.limit, m):
            last = last_split(criterion, limits, w, step, m)
            if p.number >= 0:
                interval = interval_below(
                    domain, criterion, limits, coarse, m, p.depth, w.max_depth, cell.interval.in_frame
                )
                w.stack[top].interval = interval
                visits = wp.bool(True)
                if error_m <= interval.leaf_up_to:  # then only edges can split descendants, up to the leaf depth
                    visits = p.depth + 1 < wp.min(interval.leaf_depth, w.max_depth)
    return last, visits, measured


@wp.func
def fetch_quadrants(domain: Domain, p: CellDiamond):
    """Prefetch the errors two levels below a diamond into the cache if they begin another tile of the array.

    Without this, reading them takes three quarters of the time.
    """
    if leaves_tile(domain, p.depth + 1):
        ahead = p.half >> 1
        fetch_ahead(domain, p.x - ahead, p.y - ahead, p.depth + 2)
        fetch_ahead(domain, p.x + ahead, p.y - ahead, p.depth + 2)
        fetch_ahead(domain, p.x - ahead, p.y + ahead, p.depth + 2)
        fetch_ahead(domain, p.x + ahead, p.y + ahead, p.depth + 2)


@wp.kernel
def count(domain: Domain, criterion: CriterionArrays, w: Count):
    """Count the triangles of the slice by the last step at which they are split, into `w.last_steps`.

    A step is a value of the relaxation, finest first; `w.limit_factors` has its factor on squared limits. A triangle
    that is split at a step is split at all finer ones, so its last step says all. Whenever more than `max_splits`
    triangles are split at the finest step, the next step becomes the finest. The finest step at the end is written to
    `w.from_step`; if it passes `w.coarsest`, the count ends early. `w.measured` receives the number of measured
    diamonds, and `w.marks` the cell that was reached after every `w.spacing` of them, up to MARKS cells: by them the
    next count is divided among threads. `w.slot` is the slice's number in these arrays.
    """
    no_slack = wp.float64(0.0)  # intervals need not hold for a camera that moves
    criterion.limit = w.limit_factors[w.coarsest]
    coarse = limits_of(criterion, no_slack)
    step = wp.int32(w.finest)
    total = wp.int64(0)  # triangles that are split at `step`
    measured = wp.int64(0)  # diamonds
    num_marks = wp.int32(0)
    criterion.limit = w.limit_factors[step]
    limits = limits_of(criterion, no_slack)
    bottom = w.slot * CELLS
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and step <= w.coarsest:
        w.stack[bottom] = square_cell(domain, w, square)
        top = bottom + 1
        while top > bottom and step <= w.coarsest:
            top -= 1
            cell = w.stack[top]
            # The diamonds of the cell: quadrants 3 .. 0, sides -1 .. -4. A start cell (depth -1) has its square alone.
            number = wp.int32(3)
            last_number = wp.where(cell.depth < 0, 3, -4)
            while number >= last_number:
                p = diamond_of_cell(domain, w, cell, number)
                if p.triangles > 0 and p.depth < w.max_depth:
                    last, visits, newly_measured = judge(domain, criterion, limits, coarse, w, cell, p, top, step)
                    if p.code >= w.first_cell:  # it begins in the slice
                        total += count_last_split(w, step, last, wp.int64(p.triangles))
                    measured += wp.int64(newly_measured)
                    if measured >= wp.int64(num_marks + 1) * w.spacing and num_marks < MARKS:
                        w.marks[w.slot * MARKS + num_marks] = p.code
                        num_marks += 1
                    if visits:
                        w.stack[top].x = p.x
                        w.stack[top].y = p.y
                        w.stack[top].depth = p.depth
                        w.stack[top].code = p.code
                        fetch_quadrants(domain, p)
                        top += 1
                number -= 1
            # Too many: the next step becomes the finest, at which those with this last step are split no more.
            while total > w.max_splits and step <= w.coarsest:
                total -= w.last_steps[w.slot * w.limit_factors.shape[0] + step]
                step += 1
                criterion.limit = w.limit_factors[step]
                limits = limits_of(criterion, no_slack)
        square += 1
    w.from_step[w.slot] = step
    w.measured[w.slot] = measured
