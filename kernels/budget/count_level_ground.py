# SPDX-License-Identifier: GPL-3.0-or-later
"""Counting on level ground, where no error asks for a split: footprints say at which steps most diamonds are split.

What level_ground.py is to the walk, this is to the count: a loop of its own for what is most of a plain. A
diamond is not measured but where its footprint leaves a doubt, and cells below which every step splits alike are not
looked into.
"""

import warp as wp

from ..refine.band import limits_of, measured_at
from ..refine.diamond import Asked, Domain, too_coarse_at
from ..refine.footprint import Plan, heights_between, most_below, put_limits, spans
from ..refine.walk_state import STACK
from .count_state import STEPS_PER_SQUARE, Count, halves_of, last_split, note

wp.set_module_options({"enable_backward": False})


@wp.func
def nearest_step(first: wp.int32, last: wp.int32, over: wp.float64) -> wp.int32:
    """About the last step from `first` - 1 to `last` whose limits are less than `over` times those of `first`."""
    step = wp.ceil(wp.float32(STEPS_PER_SQUARE) * wp.log2(wp.float32(over))) - 1.0
    return first + wp.int32(wp.clamp(step, -1.0, wp.float32(last - first)))


@wp.func
def count_level_ground(
    domain: Domain,
    asked: Asked,
    plan: Plan,
    w: Count,
    low: wp.float64,
    high: wp.float64,
    bottom: wp.int32,
    triangles: wp.int64,
    finest: wp.int32,
    measured_before: wp.int64,
    noted_before: wp.int32,
):
    """Count below the cell that the stack has at `bottom`, which is in the slice and away from the terrain's border.

    low, high: of its diamond, metres. triangles: that are split at `finest` so far. measured_before: diamonds.
    noted_before: places. Returns these four as they are then.
    """
    asked.limit = wp.float64(1.0)
    heights = heights_between(asked, plan, low, high)
    none = wp.float64(wp.inf)
    depths = w.slot * STACK
    climb = (high - low) * (high - low) * put_limits(domain, asked, none, none, w.max_depth, w.level_limits, depths)
    asked.limit = w.limits[finest]
    limits = limits_of(asked, wp.float64(0.0))
    coarsest = w.limits[w.coarsest]
    side = wp.int32(1) << domain.unit_bits
    cells = wp.uint64(1) << wp.uint64(w.cell_bits)
    bins = w.slot * w.limits.shape[0]
    total = triangles
    step = finest
    measured = measured_before
    noted = noted_before
    top = bottom + 1
    while top > bottom and step <= w.coarsest:
        top -= 1
        cell = w.stack[top]
        half = side >> ((cell.depth + 1) >> 1)
        quarter = half >> 1
        size = cells >> wp.uint64(cell.depth + 1)
        measured += wp.int64(1) << wp.int64(cell.halves)
        noted = note(w, cell.code, measured, noted)
        # Quadrants 3 .. 0, so that the first is the next; then sides: south and west.
        part = wp.int32(3)
        while part >= -2:
            x = cell.x
            y = cell.y
            depth = cell.depth + 2
            if part >= 0:
                x += wp.where((part & 1) == 1, quarter, -quarter)
                y += wp.where((part & 2) == 2, quarter, -quarter)
            else:
                depth -= 1
                x -= wp.where(part == -2, half, 0)
                y -= wp.where(part == -1, half, 0)
            if depth < cell.leaf_depth:
                limit = w.level_limits[depths + depth]
                least, most = spans(plan, heights, x, y, limit[0])
                last = step - 1
                if most * coarsest < limit[1]:
                    last = w.coarsest
                elif not least * asked.limit >= limit[2] + climb:
                    last = nearest_step(step, w.coarsest, limit[1] / (most * asked.limit))
                    sure = last < step or most * w.limits[last] < limit[1]
                    if not (sure and least * w.limits[last + 1] >= limit[2] + climb):
                        m = measured_at(domain, asked, x, y, depth, wp.float32(0.0), 1)
                        long2 = m.long2 + m.climb2
                        legs2 = m.legs2 + m.climb2
                        last = step - 1
                        if too_coarse_at(asked, asked.limit, m.pixel2, m.metres2, long2, legs2):
                            last = last_split(asked, limits, w.limits, step, w.coarsest, m)
                if last >= step:
                    found = wp.int64(2)
                    ends = cell.leaf_depth
                    if part >= 0:
                        near = least * asked.limit
                        while ends > depth + 1 and near >= w.level_limits[depths + ends - 1][2] + climb:
                            ends -= 1
                    if part >= 0 and ends > depth + 1:
                        deepest = w.level_limits[depths + ends - 1][1]
                        if most_below(plan, heights, x, y, limit[0]) * coarsest < deepest:
                            # 4 triangles at its sides, and twice as many at each depth from there on.
                            found += (wp.int64(4) << wp.int64(ends - 1 - depth)) - wp.int64(4)
                        else:
                            halves = halves_of(w, last, cell.halves)
                            if halves >= 0:
                                w.stack[top].x = x
                                w.stack[top].y = y
                                w.stack[top].depth = depth
                                w.stack[top].leaf_depth = ends
                                w.stack[top].halves = halves
                                w.stack[top].code = cell.code + wp.uint64(part) * size
                                top += 1
                    found = found << wp.int64(cell.halves)
                    w.last_steps[bins + last] = w.last_steps[bins + last] + found
                    total += found
            part -= 1
        if total > w.most:
            while total > w.most and step <= w.coarsest:
                total -= w.last_steps[bins + step]
                step += 1
            asked.limit = w.limits[step]
            limits = limits_of(asked, wp.float64(0.0))
    return total, step, measured, noted
