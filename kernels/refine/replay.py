# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk without a criterion: to leaves whose depths are known."""

import warp as wp

from ..field.domain import Domain
from .emit import emit
from .interval import LEAF, SPLIT
from .steps import advance, enter, middle_of, put_results, square_at
from .stored_errors import error_at
from .walk_state import Walk, Written


@wp.kernel
def replay(domain: Domain, w: Walk, depths: wp.array(dtype=wp.uint8), worst: wp.array(dtype=wp.float32)):
    """Write the leaves of all squares from their saved depths: the same words, vertices and counts as the walk wrote.

    w: a slice of the whole curve. depths: each leaf's bisections of its square, 1 or more, in curve order; the caller
    has checked that they form a tree. `worst` [1]: becomes the largest error of a leaf's diamond, metres before
    scaling.
    """
    n = Written()
    end = w.first_cell
    largest = wp.float32(0.0)
    for number in range(domain.columns * domain.rows):
        q = square_at(domain, w, number)
        c = enter(w, q)
        while c.top >= 0:
            verdict = SPLIT
            if c.depth == wp.int32(depths[n.leaves]):
                verdict = LEAF
                middle = middle_of(c)
                largest = wp.max(largest, error_at(domain, middle[0], middle[1], c.depth))
                n = emit(domain, w, q, c, n, verdict)
            c = advance(w, q, c, verdict)
        end = q.base + c.cell
    put_results(w, n, end)
    worst[0] = largest
