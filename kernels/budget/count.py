# SPDX-License-Identifier: GPL-3.0-or-later
"""How many leaves a refinement has at each of several steps of coarsening, in one pass that makes none of them.

Criteria are nested in what is asked, too: a diamond is split at every step below one of its own, and all triangles that
are split make one leaf more each. So it is enough to find each diamond's step and to count the triangles by it.

The pass does not follow the curve but the cells of a quadtree. A diamond of odd depth fills a cell, one of even depth
lies on a side of two cells and is counted in the one north or east of it: each is met once, where a walk over triangles
meets it twice. For a window of few steps it takes about half the time of a refinement, on level ground about all of it.

A window of many octaves is estimated by a sample: see `count_state.halves_of`.
"""

import warp as wp

from ..refine.band import LEVEL, Limits, Measured, leaves_below, limits_of, measured_at, splits_below
from ..refine.diamond import (
    Asked,
    Domain,
    coarsest,
    error_at,
    fetch_ahead,
    leaves_tile,
    own_for,
    sizes,
    smaller,
    too_coarse_at,
)
from ..refine.footprint import plan_of
from .count_level_ground import count_level_ground
from .count_state import CELLS, Cell, Count, halves_of, last_of_edges, last_split, note

wp.set_module_options({"enable_backward": False})

# Instead of being looked into as a cell of the quadtree.
LEVEL_GROUND = wp.constant(2)


@wp.func
def part_of(domain: Domain, w: Count, cell: Cell, part: wp.int32, size: wp.uint64):
    """Where a diamond of a cell is split, its depth, its first deepest cell, and how many of its triangles count here.

    part: 3 .. 0 are the quadrants, of `size` deepest cells each, so that the first is the next; then come the sides:
    south, west, and the terrain's own two.
    """
    half = (wp.int32(1) << domain.unit_bits) >> ((cell.depth + 1) >> 1)
    x = cell.x
    y = cell.y
    depth = cell.depth + 1
    code = cell.code
    triangles = wp.int64(2)
    if part >= 0:
        x += wp.where((part & 1) == 1, half >> 1, -(half >> 1))
        y += wp.where((part & 2) == 2, half >> 1, -(half >> 1))
        depth += 1
        if cell.depth > 0:
            code += wp.uint64(part) * size
        if code + size <= w.first_cell or code >= w.end_cell:
            triangles = wp.int64(0)
    else:
        if part == -1:
            y -= half
        elif part == -2:
            x -= half
        elif part == -3:
            y += half
        else:
            x += half
        if x == 0 or y == 0 or x == domain.columns << domain.unit_bits or y == domain.rows << domain.unit_bits:
            triangles = wp.int64(1)
        elif part < -2:
            triangles = wp.int64(0)
        if code < w.first_cell:
            triangles = wp.int64(0)
    return x, y, depth, code, triangles


@wp.func
def cell_below(
    domain: Domain,
    asked: Asked,
    limits: Limits,
    coarse: Asked,
    coarse_limits: Limits,
    w: Count,
    m: Measured,
    depth: wp.int32,
    clear: wp.int32,
):
    """What is certain below a quadrant that is split: a cell without a place, and its finest and coarsest pixel."""
    inf = wp.float64(wp.inf)
    coarse2, inside = coarsest(asked, m.diamond, clear)
    coarse2 = coarse2 * limits.coarser
    fine2 = m.pixel2 * limits.finer
    fine = smaller(limits.error_px * wp.sqrt(fine2), limits.metres_below)
    rough = smaller(coarse_limits.error_px * wp.sqrt(coarse2), coarse_limits.metres_above)
    cell = Cell()
    cell.leaf_up_to = own_for(fine, m.rest, domain.source)
    cell.split_above = own_for(rough, domain.rounding, domain.source)
    cell.leaf_depth = leaves_below(asked, depth, w.max_depth, m.long2, m.legs2, m.climb2, fine2, inf, inf)
    cell.split_depth = splits_below(coarse, depth, w.max_depth, m.long2, m.legs2, coarse2)
    cell.clear = inside
    return cell, fine2, coarse2


@wp.func
def alike_below(
    domain: Domain,
    asked: Asked,
    limits: Limits,
    w: Count,
    step: wp.int32,
    m: Measured,
    cell: Cell,
    fine2: wp.float64,
    coarse2: wp.float64,
):
    """Whether every diamond at a depth below a cell without errors is split for the last time at the same step.

    All are, but for one depth at most: returns that depth's last step, too.
    """
    alike = cell.leaf_depth - cell.split_depth < 2
    last = w.coarsest
    if alike and cell.leaf_depth > cell.split_depth:
        none = wp.float64(0.0)
        first = step
        depth = cell.split_depth
        last = last_of_edges(asked, limits, w.limits, first, w.coarsest, domain.unit_bits, depth, m.climb2, fine2)
        alike = last == last_of_edges(
            asked, limits, w.limits, first, w.coarsest, domain.unit_bits, depth, none, coarse2
        )
    return alike, last


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
    plan = plan_of(domain, coarse, w.max_depth)
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
            halves = wp.int64(cell.halves)
            size = cells >> wp.uint64(cell.depth + 1)
            quarter = side >> ((cell.depth + 3) >> 1)
            part = wp.int32(3)
            last_part = wp.where(cell.depth < 0, 3, -4)
            while part >= last_part:
                x, y, depth, code, triangles = part_of(domain, w, cell, part, size)
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
                        measured += wp.int64(1) << halves
                        noted = note(w, code, measured, noted)
                        long2 = m.long2 + m.climb2
                        legs2 = m.legs2 + m.climb2
                        below = 0
                        if too_coarse_at(asked, asked.limit, m.pixel2, m.metres2, long2, legs2):
                            last = last_split(asked, limits, w.limits, step, w.coarsest, m)
                            if part >= 0:
                                found, fine2, coarse2 = cell_below(
                                    domain, asked, limits, coarse, coarse_limits, w, m, depth, cell.clear
                                )
                                # Field by field: see kernels/refine/walk.py. A tenth of the search.
                                inner.leaf_up_to = found.leaf_up_to
                                inner.split_above = found.split_above
                                inner.leaf_depth = found.leaf_depth
                                inner.split_depth = found.split_depth
                                inner.clear = found.clear
                                below = 1
                                if m.own <= inner.leaf_up_to:
                                    below = wp.int32(depth + 1 < inner.leaf_depth)
                                    whole = below == 1 and code >= w.first_cell and code + size <= w.end_cell
                                    whole = whole and x > quarter and y > quarter
                                    whole = whole and x + quarter < east and y + quarter < north
                                    alike = wp.bool(False)
                                    last_below = w.coarsest
                                    if whole:
                                        alike, last_below = alike_below(
                                            domain, asked, limits, w, step, m, inner, fine2, coarse2
                                        )
                                    if alike:
                                        below = 0
                                        # 4 triangles at its sides, and twice as many at each depth from there on.
                                        certain = wp.int64(4) << (wp.int64(inner.split_depth - depth - 1) + halves)
                                        below_sides = certain - (wp.int64(4) << halves)
                                        w.last_steps[bins + w.coarsest] = w.last_steps[bins + w.coarsest] + below_sides
                                        total += below_sides
                                        if inner.leaf_depth > inner.split_depth and last_below >= step:
                                            w.last_steps[bins + last_below] = w.last_steps[bins + last_below] + certain
                                            total += certain
                                    elif whole and plan.usable == 1 and inner.clear == 1:
                                        height = m.diamond.high[2] - m.diamond.low[2]
                                        leaf2, _legs2 = sizes(asked, domain.unit_bits, inner.leaf_depth)
                                        if height * height <= LEVEL * leaf2:
                                            below = LEVEL_GROUND
                    if last >= step and code >= w.first_cell:
                        w.last_steps[bins + last] = w.last_steps[bins + last] + (triangles << halves)
                        total += triangles << halves
                    if below > 0:
                        inner.halves = halves_of(w, last, cell.halves)
                        below = wp.where(inner.halves < 0, 0, below)
                    if below > 0:
                        inner.x = x
                        inner.y = y
                        inner.depth = depth
                        inner.code = code
                        w.stack[place + top] = inner
                        if leaves_tile(domain, depth + 1):  # three quarters of the time, for errors
                            ahead = quarter >> 1
                            fetch_ahead(domain, x - ahead, y - ahead, depth + 2)
                            fetch_ahead(domain, x + ahead, y - ahead, depth + 2)
                            fetch_ahead(domain, x - ahead, y + ahead, depth + 2)
                            fetch_ahead(domain, x + ahead, y + ahead, depth + 2)
                        top += wp.where(below == LEVEL_GROUND, 0, 1)
                    if below == LEVEL_GROUND:
                        total, step, measured, noted = count_level_ground(
                            domain, asked, plan, w, m.diamond.low[2], m.diamond.high[2],
                            place + top, total, step, measured, noted,
                        )  # fmt: skip
                        asked.limit = w.limits[step]
                        limits = limits_of(asked, wp.float64(0.0))
                part -= 1
            while total > w.most and step <= w.coarsest:
                total -= w.last_steps[bins + step]
                step += 1
                asked.limit = w.limits[step]
                limits = limits_of(asked, wp.float64(0.0))
        square += 1
    w.from_step[w.slot] = step
    w.measured[w.slot] = measured
