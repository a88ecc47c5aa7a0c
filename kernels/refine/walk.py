# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: one walk over the triangles in curve order that splits whatever is too coarse.

plain.py is the same method without its short cuts. Here a triangle's leaves may be *taken* from the last frame
(kept.py); else its diamond is *judged*. Below a diamond that is split, a *band* says what is certain (band.py), so most
are judged by a look at their error, or at nothing but their depth. Only one that is in doubt is measured, and makes a
narrower band for what is below it. Leaves of one depth are written as an even block.
"""

import warp as wp

from ..field.domain import Domain
from .band import (
    DOUBT,
    EVEN_BLOCK,
    LEAF,
    SPLIT,
    TAKEN,
    Limits,
    band_below,
    foretold,
    limits_of,
    measured_at,
    too_coarse,
)
from .block import MAX_BISECTIONS
from .emit import emit, stands_alone
from .kept import begin_keeping, close_subtree, looks_for_subtree, note_turning, open_subtree, take
from .pixels import Asked
from .steps import advance, enter, middle_of, put_results, square_at
from .stored_errors import error_at, fetch_ahead, leaves_tile
from .walk_state import STACK, Cursor, Square, Walk, Written

# A diamond that is surely split is measured if depths alone decide below it, but which ones is in doubt for more than
# so many bisections: a narrower band may leave none. One of even depth, whose box is tighter (`reach_of`).
NARROWED = wp.constant(2)


@wp.func
def judge(domain: Domain, asked: Asked, limits: Limits, w: Walk, q: Square, c: Cursor, n: Written):
    """The verdict on a triangle, SPLIT, LEAF or EVEN_BLOCK, and the band that holds below it."""
    middle = middle_of(c)
    above = w.bands[c.held]
    held = c.held
    error = wp.float32(0.0)  # where depths alone decide, errors need not be read
    if above.calm == 0:
        error = error_at(domain, middle[0], middle[1], c.depth)
    verdict = foretold(above, c.depth, wp.float64(error) * domain.error_scale)
    if c.depth < w.max_depth:
        narrows = above.calm == 1 and above.even_depth == 0 and (c.depth & 1) == 0
        narrows = narrows and above.leaf_depth - c.depth > NARROWED
        if (narrows and verdict == SPLIT) or looks_for_subtree(w, q, c):
            verdict = DOUBT
    elif w.keeper[w.slot].stopped == 1:
        verdict = LEAF  # and nothing more can be learnt of it
    if verdict == DOUBT:
        m = measured_at(domain, asked, middle[0], middle[1], c.depth, error, above.in_frame)
        verdict = LEAF
        if too_coarse(asked, asked.limit, m):
            verdict = SPLIT
            if c.depth < w.max_depth:
                band = band_below(domain, asked, limits, limits, m, c.depth, w.max_depth, above.in_frame)
                held = w.slot * STACK + c.top
                w.bands[held] = band
                open_subtree(asked, w, q, c, m, band, n)
        note_turning(asked, limits, w, m)
    if c.depth == w.max_depth and verdict == SPLIT:
        w.keeper[w.slot].stopped = 1
        verdict = LEAF
    bisections = w.bands[held].even_depth - c.depth
    if verdict == SPLIT and bisections > 0 and bisections <= MAX_BISECTIONS:
        if stands_alone(w, q, c):
            verdict = EVEN_BLOCK
            if w.bands[held].leaf_depth > w.max_depth:
                w.keeper[w.slot].stopped = 1
    return verdict, held


@wp.func
def fetch_children(domain: Domain, w: Walk, c: Cursor):
    """Bring the errors of a triangle's children's children into the cache, a step ahead."""
    if w.bands[c.held].calm == 0 and leaves_tile(domain, c.depth + 1):
        x = (c.left[0] + c.right[0]) >> 1
        y = (c.left[1] + c.right[1]) >> 1
        fetch_ahead(domain, (c.left[0] + x) >> 1, (c.left[1] + y) >> 1, c.depth + 2)
        fetch_ahead(domain, (c.apex[0] + x) >> 1, (c.apex[1] + y) >> 1, c.depth + 2)
        fetch_ahead(domain, (c.right[0] + x) >> 1, (c.right[1] + y) >> 1, c.depth + 2)


@wp.kernel
def walk(domain: Domain, asked: Asked, w: Walk):
    """Refine the leaves whose first deepest cell lies in the slice; what does not fit is only counted."""
    limits = limits_of(asked, w.slack)
    n = Written()
    begin_keeping(w)
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and n.leaves <= w.leaf_limit:
        q = square_at(domain, w, square)
        c = enter(w, q)
        while c.top >= 0 and n.leaves <= w.leaf_limit:
            verdict = take(asked, w, q, c, n)
            held = c.held
            if verdict != TAKEN:
                verdict, held = judge(domain, asked, limits, w, q, c, n)
            c.held = held
            n = emit(domain, w, q, c, n, verdict)
            if verdict == SPLIT:
                fetch_children(domain, w, c)
            c = advance(w, q, c, verdict)
            if verdict != SPLIT:
                close_subtree(w, q.base + c.cell, n)
        square += 1
    put_results(w, n)
