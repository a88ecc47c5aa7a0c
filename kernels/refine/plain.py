# SPDX-License-Identifier: GPL-3.0-or-later
"""The method as a kernel without shortcuts and without a cache: tests compare the walk with it.

cbt_terrain/refine/reference.py is the same method in Python; begin reading there.

A triangle is split if its *diamond* is too coarse. The diamond is the triangle and its neighbour across the longest
edge; a split adds one vertex for both. The coarseness of a diamond depends only on its error and its box (diamond.py).
Both are nested: no diamond has a larger error, or a finer pixel on its box, than its parents. So the parents of a split
diamond are split: a walk from the roots that tests each triangle once gives a conforming mesh, which is a function of
the view alone (Lindstrom and Pascucci 2002, section 4).

Children are visited so that consecutive leaves share an edge: the Sierpinski curve (curve.py). It may be cut anywhere
into slices for parallel walks; each walk descends from the roots to its first cell.

`w`: the slice's Walk. `q`: its current square; `q.base` is its first deepest cell. `c`: its cursor; `c.top` becomes -1
at the end of the square or the slice. `n`: its counts so far.
"""

import warp as wp

from ..field.domain import Domain
from .emit import emit
from .interval import LEAF, SPLIT, measure_diamond, too_coarse
from .pixels import CriterionArrays
from .steps import STOPPED, advance, enter, middle_of, put_results, square_at
from .stored_errors import error_at
from .walk_state import Walk, Written


# Tests turn it into a kernel: declared here it would be compiled before the first frame.
def walk(domain: Domain, criterion: CriterionArrays, w: Walk):
    """Refine the leaves of a slice of the curve by measuring every diamond, and write them with their counts.

    This is the plain form of the kernel in walk.py, which writes the same bytes but skips measurements. A triangle is
    split while its diamond is too coarse; one at `w.max_depth` stays a leaf and sets entry STOPPED of the slice's
    counts. Above `w.leaf_limit` leaves the walk ends early.
    """
    n = Written()
    end = w.first_cell
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and n.leaves <= w.leaf_limit:
        q = square_at(domain, w, square)
        c = enter(w, q)
        while c.top >= 0 and n.leaves <= w.leaf_limit:
            middle = middle_of(c)
            error = error_at(domain, middle[0], middle[1], c.depth)
            m = measure_diamond(domain, criterion, middle[0], middle[1], c.depth, error, 0)
            verdict = wp.int32(LEAF)
            if too_coarse(criterion, criterion.limit, m):
                if c.depth < w.max_depth:
                    verdict = SPLIT
                else:
                    w.counts[4 * w.slot + STOPPED] = wp.int64(1)
            n = emit(domain, w, q, c, n, verdict)
            c = advance(w, q, c, verdict)
        end = q.base + c.cell
        square += 1
    put_results(w, n, end)
