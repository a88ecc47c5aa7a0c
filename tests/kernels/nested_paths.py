# SPDX-License-Identifier: GPL-3.0-or-later
"""A kernel for test_nested.py: random ways down the diamonds, and where a child exceeds its parent."""

import warp as wp

from ..field.domain import Domain
from .excess import half_of, root_triangle
from .interval import measure_diamond, too_coarse
from .pixels import CriterionArrays, coarsest
from .stored_errors import error_at


@wp.kernel
def nested_paths(
    domain: Domain, asked: CriterionArrays, ways: wp.array(dtype=wp.uint64), found: wp.array(dtype=wp.int32)
):
    """Go down the diamonds. ways: bits that choose children. found, added up over the ways: diamonds; those with a
    finer pixel than their parent (of heights or of edges), with a larger error, split below one that is not, and with a
    coarser pixel than an ancestor allows."""
    for n in range(ways.shape[0]):
        way = ways[n]
        t = root_triangle(domain, wp.int32(way % wp.uint64(2 * domain.columns * domain.rows)), 0, wp.uint64(1))
        pixel2 = wp.float64(0.0)
        edge2 = wp.float64(0.0)
        metres2 = wp.float64(wp.inf)
        split = wp.bool(True)
        coarse2 = wp.float64(wp.inf)
        coarse_edge2 = wp.float64(wp.inf)
        for depth in range(1, 2 * domain.unit_bits - 1):
            x = (t.left[0] + t.right[0]) >> 1
            y = (t.left[1] + t.right[1]) >> 1
            m = measure_diamond(domain, asked, x, y, depth, error_at(domain, x, y, depth), 0)
            below, edge_below, _inside = coarsest(asked, m.diamond, 0)
            found[0] += 1
            if m.pixel2 < pixel2 or m.edge2 < edge2 or m.pixel2 < m.edge2:
                found[1] += 1
            if m.metres2 > metres2:
                found[2] += 1
            if too_coarse(asked, asked.limit, m) and not split:
                found[3] += 1
            above = wp.float64(1.0 + 1e-12)
            if m.diamond.border == 0 and (m.pixel2 > coarse2 * above or m.edge2 > coarse_edge2 * above):
                found[4] += 1
            split = too_coarse(asked, asked.limit, m)
            pixel2 = m.pixel2
            edge2 = m.edge2
            metres2 = m.metres2
            coarse2 = wp.min(below, coarse2)
            coarse_edge2 = wp.min(edge_below, coarse_edge2)
            t = half_of(t, wp.int32((way >> wp.uint64(depth)) & wp.uint64(1)))
