# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: one walk over the triangles in curve order that splits every triangle that is too coarse.

plain.py is the same method without shortcuts. Here the leaves below a triangle may be *reused* from the last frame
(reuse.py); otherwise its diamond is *judged*. A split diamond gives an *interval* (interval.py), which decides most
diamonds below it by their error, or by their depth alone. A diamond in doubt is measured, and gives a narrower interval
for those below it. The curve often crosses from one triangle of a diamond to the other: the last measure of each depth
is kept, so the second one need not be measured. Where an interval gives all leaves below one depth (`even_depth`, else
0), they are written as an even block.

A verdict is SPLIT, LEAF, EVEN_BLOCK, REUSED or DOUBT: the diamond must be measured. `w`: the slice's Walk. `q`: its
current square; `q.base` is its first deepest cell. `c`: its cursor: a triangle, the index of its interval in
`w.intervals`, and the `top` of the stack of triangles that follow (-1: the square or the slice has ended). `n`: its
counts so far. `r`: the last frame's subtrees and the slice's lists.
"""

import warp as wp

from ..field.domain import INLINED, Domain
from ..leb.halfway import halfway
from .block import MAX_BISECTIONS
from .diamond import fetch_range, leaves_range_tile
from .emit import can_copy_block, emit
from .interval import (
    DOUBT,
    EVEN_BLOCK,
    LEAF,
    REUSED,
    SPLIT,
    Limits,
    interval_below,
    limits_of,
    measure_diamond,
    predict,
    too_coarse,
)
from .pixels import CriterionArrays
from .reuse import (
    begin_reuse,
    close_subtree,
    count_reused,
    end_reuse,
    may_begin_subtree,
    narrow_margins,
    open_subtree,
    reuse_subtree,
)
from .reuse_state import Reuse
from .steps import STOPPED, advance, enter, middle_of, put_results, square_at
from .stored_errors import SURE, error_at, fetch_ahead, leaves_tile, may_be_less, stored_error_at
from .walk_state import STACK, Cursor, Square, Walk, Written

# Measure a diamond even if it will certainly be split when its interval leaves more than NARROWED levels undecided: a
# tighter interval often decides them all. Only at even depths, whose boxes are tighter (`reach_of`).
NARROWED = wp.constant(2)

wp.set_module_options(INLINED)


@wp.func
def judge(
    domain: Domain, criterion: CriterionArrays, limits: Limits, w: Walk, r: Reuse, q: Square, c: Cursor, n: Written
):
    """Decide the cursor's triangle: return SPLIT, LEAF or EVEN_BLOCK, and the index in `w.intervals` for its children.

    limits: the criterion with the margins of the intervals. The interval from above decides if it can; otherwise the
    diamond is measured, unless it was measured just before, for its other triangle. A measured diamond and its interval
    are stored in `w`, and a subtree may be opened or its margins narrowed in `r`. A diamond that is too coarse at
    `w.max_depth` is a LEAF and sets entry STOPPED of the slice's counts. An exact error is at least SURE times the
    stored one.
    """
    middle = middle_of(c)
    above = w.intervals[c.interval_index]
    interval_index = c.interval_index
    error = wp.float32(0.0)  # where depths alone decide, errors need not be read
    min_fraction = wp.float64(1.0)  # of the stored error, that the exact one is at least
    if above.depths_decide == 0:
        error = stored_error_at(domain, middle[0], middle[1], c.depth)
        if may_be_less(domain, c.depth):
            min_fraction = SURE
    error_m = wp.float64(error) * domain.error_scale
    verdict = predict(above, c.depth, min_fraction * error_m, error_m)
    if c.depth < w.max_depth:
        # A certain split is measured for a tighter interval (see NARROWED), or to begin a subtree that is cached.
        would_narrow = above.depths_decide == 1 and above.even_depth == 0 and (c.depth & 1) == 0
        would_narrow = would_narrow and above.leaf_depth - c.depth > NARROWED
        if (would_narrow and verdict == SPLIT) or may_begin_subtree(w, r, q, c):
            verdict = DOUBT
    elif w.counts[4 * w.slot + STOPPED] == wp.int64(1):
        verdict = LEAF  # to measure it could only set STOPPED, which is set
    if verdict == DOUBT:
        entry = w.slot * STACK + c.depth
        if not (w.diamonds[entry].middle == middle):  # it was not measured just before
            if min_fraction < wp.float64(1.0):
                error = error_at(domain, middle[0], middle[1], c.depth)
            m = measure_diamond(domain, criterion, middle[0], middle[1], c.depth, error, above.in_frame)
            m.verdict = wp.where(too_coarse(criterion, criterion.limit, m), SPLIT, LEAF)
            w.diamonds[entry] = m
            if m.verdict == SPLIT and c.depth < w.max_depth:
                # The finest and the coarsest limits are the same in a walk.
                w.intervals[entry] = interval_below(
                    domain, criterion, limits, limits, m, c.depth, w.max_depth, above.in_frame
                )
        verdict = w.diamonds[entry].verdict
        if verdict == SPLIT and c.depth < w.max_depth:
            interval_index = entry
            open_subtree(criterion, w, r, q, c, w.diamonds[entry], w.intervals[entry], n)
        narrow_margins(criterion, limits, w, r, w.diamonds[entry])
    if c.depth == w.max_depth and verdict == SPLIT:  # too coarse at the depth limit
        w.counts[4 * w.slot + STOPPED] = wp.int64(1)
        verdict = LEAF
    bisections = w.intervals[interval_index].even_depth - c.depth
    if verdict == SPLIT and bisections > 0 and bisections <= MAX_BISECTIONS:
        if can_copy_block(w, q, c):
            verdict = EVEN_BLOCK
            if w.intervals[interval_index].leaf_depth > w.max_depth:  # its leaves are too coarse
                w.counts[4 * w.slot + STOPPED] = wp.int64(1)
    return verdict, interval_index


@wp.func
def fetch_children(domain: Domain, w: Walk, c: Cursor):
    """Prefetch the errors or height ranges of a split triangle's grandchildren if they begin another tile of the array.

    c: at the triangle, with the interval for its children, which decides whether errors (`fetch_ahead`) or ranges
    (`fetch_range`) will be read.
    """
    interval = w.intervals[c.interval_index]
    x = halfway(c.left[0], c.right[0])
    y = halfway(c.left[1], c.right[1])
    if interval.depths_decide == 0 and leaves_tile(domain, c.depth + 1):
        fetch_ahead(domain, halfway(c.left[0], x), halfway(c.left[1], y), c.depth + 2)
        fetch_ahead(domain, halfway(c.apex[0], x), halfway(c.apex[1], y), c.depth + 2)
        fetch_ahead(domain, halfway(c.right[0], x), halfway(c.right[1], y), c.depth + 2)
    elif interval.even_depth == 0 and leaves_range_tile(domain, c.depth + 1):
        fetch_range(domain, halfway(c.left[0], x), halfway(c.left[1], y), c.depth + 2)
        fetch_range(domain, halfway(c.apex[0], x), halfway(c.apex[1], y), c.depth + 2)
        fetch_range(domain, halfway(c.right[0], x), halfway(c.right[1], y), c.depth + 2)


@wp.kernel
def walk(domain: Domain, criterion: CriterionArrays, w: Walk, r: Reuse):
    """Refine one slice of the curve: list the leaves whose first deepest cell belongs to it.

    Leaves beyond `w.leaf_capacity` are only counted, and the caller walks again with more room. Above `w.leaf_limit`
    leaves the walk ends early with incomplete counts: the frame is then refined again with a coarser criterion.
    """
    limits = limits_of(criterion, r.slack)
    n = Written()
    end = w.first_cell
    begin_reuse(r, w.slot)
    for depth in range(STACK):
        w.diamonds[w.slot * STACK + depth].middle = wp.vec2i(-1, -1)  # no diamond of this depth is measured yet
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and n.leaves <= w.leaf_limit:
        q = square_at(domain, w, square)
        c = enter(w, q)
        while c.top >= 0 and n.leaves <= w.leaf_limit:
            verdict = reuse_subtree(criterion, w, r, q, c, n)
            interval_index = c.interval_index
            if verdict != REUSED:
                verdict, interval_index = judge(domain, criterion, limits, w, r, q, c, n)
            c.interval_index = interval_index
            n = emit(domain, w, q, c, n, verdict)
            n = count_reused(r, w.slot, n, verdict)
            if verdict == SPLIT:
                fetch_children(domain, w, c)  # into the processor's cache
            c = advance(w, q, c, verdict)
            if verdict != SPLIT:
                close_subtree(w, r, q.base + c.cell, n)
        end = q.base + c.cell
        square += 1
    put_results(w, n, end)
    end_reuse(r, w.slot)
