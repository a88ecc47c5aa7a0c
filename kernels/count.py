# SPDX-License-Identifier: GPL-3.0-or-later
"""How many leaves a refinement has at each of several steps of coarsening, in one pass that makes none of them.

Criteria are nested in what is asked, too: a diamond is split at every step below one of its own, and all triangles that
are split make one leaf more each. So it is enough to find each diamond's step and to count the triangles by it.

The pass does not follow the curve but the cells of a quadtree. A diamond of odd depth fills a cell, one of even depth
lies on a side of two cells and is counted in the one north or east of it: each is met once, where a walk over triangles
meets it twice. It takes a half to nine tenths of the time of a refinement; on level ground, where that takes little,
several times as long.
"""

import warp as wp

from .band import Limits, Measured, leaves_below, limits_of, measured_at, splits_below
from .criterion import Asked, Domain, coarsest, error_at, larger, own_for, sizes, smaller, too_coarse_at

wp.set_module_options({"enable_backward": False})

CELLS = wp.constant(128)  # entries of a slice's stack: three for every second level are enough
STEPS_PER_OCTAVE = 32
# Squared limits are 2^(1/16) apart.
STEPS_PER_SQUARE = wp.constant(wp.float64(STEPS_PER_OCTAVE / 2))
MARKS = wp.constant(256)  # places that a slice notes, evenly by what it has measured


@wp.struct
class Cell:
    """A cell whose diamond is split, and what is certain of the diamonds below it at all steps that are counted."""

    x: wp.int32  # its middle
    y: wp.int32
    depth: wp.int32
    clear: wp.int32  # the frustum holds the diamond's box
    split_depth: wp.int32  # above it edges ask for a split
    leaf_depth: wp.int32  # from it on they do not
    code: wp.uint64  # its first deepest cell, all squares in a row
    split_above: wp.float64  # metres of own error: above, a diamond is split
    leaf_up_to: wp.float64  # ... up to these no error asks for a split


@wp.struct
class Count:
    """Which part of the quadtree a slice counts, and for which steps."""

    first_cell: wp.uint64  # slice [first_cell, end_cell) of deepest cells, all squares in a row
    end_cell: wp.uint64
    cell_bits: wp.int32  # deepest cells in a square: 2**cell_bits
    max_depth: wp.int32
    slot: wp.int32
    finest: wp.int32  # steps from this one
    coarsest: wp.int32  # ... to this one
    most: wp.int64  # steps at which more triangles than this are split are of no interest
    spacing: wp.int64  # diamonds that are measured from mark to mark
    limits: wp.array(dtype=wp.float64)  # of each step: what is asked is multiplied by it
    stack: wp.array(dtype=Cell)
    last_steps: wp.array(
        dtype=wp.int64
    )  # per slice and step: triangles for which it is the last at which they are split
    from_step: wp.array(dtype=wp.int32)  # per slice: counts hold from here on; more than `coarsest`: nowhere
    marks: wp.array(dtype=wp.uint64)  # per slice: places, see MARKS
    measured: wp.array(dtype=wp.int64)  # per slice: diamonds


@wp.func
def last_split(
    asked: Asked, limits: Limits, steps: wp.array(dtype=wp.float64), first: wp.int32, last: wp.int32, m: Measured
):
    """The last step from `first` to `last` at which a diamond is split that is at `first`.

    limits: those of `first`. A logarithm says which one it is or nearly so; what decides is what the walk does.
    """
    long2 = m.long2 + m.climb2
    legs2 = m.legs2 + m.climb2
    over = larger(m.metres2 * limits.per_error2, larger(long2 * limits.per_edge2, legs2 * limits.per_area2)) / m.pixel2
    over = larger(over, m.metres2 / (limits.metres_above * limits.metres_above))
    beyond = wp.float64(wp.log2(wp.float32(over))) * STEPS_PER_SQUARE
    step = first + wp.int32(larger(smaller(beyond, wp.float64(last - first)), wp.float64(0.0)))
    while step < last and too_coarse_at(asked, steps[step + 1], m.pixel2, m.metres2, long2, legs2):
        step += 1
    while step > first and not too_coarse_at(asked, steps[step], m.pixel2, m.metres2, long2, legs2):
        step -= 1
    return step


@wp.func
def last_of_edges(
    asked: Asked,
    limits: Limits,
    steps: wp.array(dtype=wp.float64),
    first: wp.int32,
    last: wp.int32,
    unit_bits: wp.int32,
    depth: wp.int32,
    climb2: wp.float64,
    pixel2: wp.float64,
):
    """As `last_split`, of edges alone, where a pixel spans sqrt(pixel2); `first` - 1 if they ask for none at all."""
    m = Measured()
    long2, legs2 = sizes(asked, unit_bits, depth)
    m.long2 = long2
    m.legs2 = legs2
    m.climb2 = climb2
    m.pixel2 = pixel2
    step = first - 1
    if too_coarse_at(asked, steps[first], pixel2, wp.float64(0.0), long2 + climb2, legs2 + climb2):
        step = last_split(asked, limits, steps, first, last, m)
    return step


@wp.kernel
def count(domain: Domain, asked: Asked, coarse: Asked, w: Count):
    """Count the diamonds of the slice by the last step at which they are split. `coarse`: as `asked`.

    As soon as there are more than `most` at the finest step, that is given up for the next one.
    """
    inf = wp.float64(wp.inf)
    side = wp.int32(1) << domain.unit_bits
    east = domain.columns << domain.unit_bits
    north = domain.rows << domain.unit_bits
    cells = wp.uint64(1) << wp.uint64(w.cell_bits)
    has_errors = asked.error_px2 < inf or asked.metres2 < inf
    step = w.finest
    asked.limit = w.limits[step]
    limits = limits_of(asked, wp.float64(0.0))
    coarse.limit = w.limits[w.coarsest]
    coarse_limits = limits_of(coarse, wp.float64(0.0))
    total = wp.int64(0)
    measured = wp.int64(0)
    noted = wp.int32(0)
    bins = w.slot * w.limits.shape[0]
    place = w.slot * CELLS
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and step <= w.coarsest:
        row = square / domain.columns
        column = square - row * domain.columns
        # Of a cell around it the square is the north-eastern quadrant; nothing is certain of it.
        around = Cell()
        around.x = column << domain.unit_bits
        around.y = row << domain.unit_bits
        around.depth = -1
        around.leaf_depth = 1 << 30
        around.code = wp.uint64(square) << wp.uint64(w.cell_bits)
        around.split_above = inf
        around.leaf_up_to = wp.float64(-1.0)
        w.stack[place] = around
        top = wp.int32(1)
        while top > 0 and step <= w.coarsest:
            top -= 1
            cell = w.stack[place + top]
            half = side >> ((cell.depth + 1) >> 1)
            quarter = half >> 1
            size = cells >> wp.uint64(cell.depth + 1)  # deepest cells of a quadrant
            # Quadrants 3 .. 0, so that the first is the next; then sides: south, west, and the terrain's own two.
            part = wp.int32(3)
            last_part = wp.int32(-4)
            if cell.depth < 0:
                last_part = 3
            while part >= last_part:
                x = cell.x
                y = cell.y
                depth = cell.depth + 2
                code = cell.code
                triangles = wp.int64(2)
                if part >= 0:
                    x += wp.where((part & 1) == 1, quarter, -quarter)
                    y += wp.where((part & 2) == 2, quarter, -quarter)
                    if cell.depth > 0:
                        code += wp.uint64(part) * size
                    if code + size <= w.first_cell or code >= w.end_cell:
                        triangles = wp.int64(0)
                else:
                    depth -= 1
                    if part == -1:
                        y -= half
                    elif part == -2:
                        x -= half
                    elif part == -3:
                        y += half
                    else:
                        x += half
                    if x == 0 or y == 0 or x == east or y == north:
                        triangles = wp.int64(1)
                    if code < w.first_cell or (part < -2 and triangles == wp.int64(2)):
                        triangles = wp.int64(0)
                    if (part == -3 and y < north) or (part == -4 and x < east):
                        triangles = wp.int64(0)
                if triangles > wp.int64(0) and depth < w.max_depth:
                    error = wp.float32(0.0)
                    if has_errors:
                        error = error_at(domain, x, y, depth)
                    own = wp.float64(error) * domain.error_scale
                    calm = own <= cell.leaf_up_to
                    last = step - 1  # at which it is split
                    below = wp.int32(0)
                    if depth < cell.split_depth or own > cell.split_above:
                        last = w.coarsest
                        below = wp.int32(part >= 0)
                    inner = cell
                    # What is certain to be split is measured for what can be said below it.
                    if (last < step and (not calm or depth < cell.leaf_depth)) or (below == 1 and calm):
                        m = measured_at(domain, asked, x, y, depth, error, cell.clear)
                        measured += wp.int64(1)
                        if measured == wp.int64(noted + 1) * w.spacing and noted < MARKS:
                            w.marks[w.slot * MARKS + noted] = code
                            noted += 1
                        long2 = m.long2 + m.climb2
                        legs2 = m.legs2 + m.climb2
                        below = 0
                        if too_coarse_at(asked, asked.limit, m.pixel2, m.metres2, long2, legs2):
                            last = last_split(asked, limits, w.limits, step, w.coarsest, m)
                            if part >= 0:
                                coarse2, inside = coarsest(asked, m.diamond, cell.clear)
                                coarse2 = coarse2 * limits.coarser
                                fine2 = m.pixel2 * limits.finer
                                fine = smaller(limits.error_px * wp.sqrt(fine2), limits.metres_below)
                                rough = smaller(coarse_limits.error_px * wp.sqrt(coarse2), coarse_limits.metres_above)
                                inner.leaf_up_to = own_for(fine, m.rest, domain.source)
                                inner.split_above = own_for(rough, domain.rounding, domain.source)
                                inner.leaf_depth = leaves_below(
                                    asked, depth, w.max_depth, m.long2, m.legs2, m.climb2, fine2, inf, inf
                                )
                                inner.split_depth = splits_below(coarse, depth, w.max_depth, m.long2, m.legs2, coarse2)
                                inner.clear = inside
                                below = 1
                                if m.own <= inner.leaf_up_to:
                                    below = wp.int32(depth + 1 < inner.leaf_depth)
                                    # All below are alike, but for one depth at most, and that is of one step.
                                    alike = inner.leaf_depth - inner.split_depth < 2 and below == 1
                                    alike = alike and code >= w.first_cell and code + size <= w.end_cell
                                    alike = alike and x > quarter and y > quarter
                                    alike = alike and x + quarter < east and y + quarter < north
                                    last_below = w.coarsest
                                    if alike and inner.leaf_depth > inner.split_depth:
                                        last_below = last_of_edges(
                                            asked, limits, w.limits, step, w.coarsest, domain.unit_bits,
                                            inner.split_depth, m.climb2, fine2,
                                        )  # fmt: skip
                                        other = last_of_edges(
                                            asked, limits, w.limits, step, w.coarsest, domain.unit_bits,
                                            inner.split_depth, wp.float64(0.0), coarse2,
                                        )  # fmt: skip
                                        alike = last_below == other
                                    if alike:
                                        below = 0
                                        # 4 triangles at its sides, and twice as many at each depth from there on.
                                        certain = wp.int64(4) * (
                                            (wp.int64(1) << wp.int64(inner.split_depth - depth - 1)) - wp.int64(1)
                                        )
                                        w.last_steps[bins + w.coarsest] = w.last_steps[bins + w.coarsest] + certain
                                        total += certain
                                        if inner.leaf_depth > inner.split_depth and last_below >= step:
                                            more = wp.int64(4) << wp.int64(inner.split_depth - depth - 1)
                                            w.last_steps[bins + last_below] = w.last_steps[bins + last_below] + more
                                            total += more
                    if below == 1:
                        inner.x = x
                        inner.y = y
                        inner.depth = depth
                        inner.code = code
                        w.stack[place + top] = inner
                        top += 1
                    if last >= step and code >= w.first_cell:
                        w.last_steps[bins + last] = w.last_steps[bins + last] + triangles
                        total += triangles
                part -= 1
            while total > w.most and step <= w.coarsest:
                total -= w.last_steps[bins + step]
                step += 1
                asked.limit = w.limits[step]
                limits = limits_of(asked, wp.float64(0.0))
        square += 1
    w.from_step[w.slot] = step
    w.measured[w.slot] = measured
