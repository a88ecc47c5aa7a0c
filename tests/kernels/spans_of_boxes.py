# SPDX-License-Identifier: GPL-3.0-or-later
"""A kernel for test_coherence.py: the finest pixel on boxes, from two views, and the bounds of their difference."""

import warp as wp

from .coherence import FADED, Motion, Subtree, footprint_change
from .diamond import Diamond
from .local_view import LocalView
from .pixels import CriterionArrays, finest_in


@wp.kernel
def spans_of_boxes(
    asked: CriterionArrays,
    before: LocalView,
    motion: Motion,
    subtree: Subtree,
    boxes: wp.array(dtype=wp.vec3d),
    spans: wp.array2d(dtype=wp.float64),
    change: wp.array(dtype=wp.float64),
):
    """Write footprints on boxes and the bounds of their change.

    boxes: lowest and highest corner in turns. spans [n, 4]: metres of heights before and now, of edges before and now.
    change: lower, upper, valid; of heights, and of edges too if the criterion measures them.
    """
    subtree.fine = wp.float64(wp.inf)
    subtree.coarse = wp.float64(0.0)
    for k in range(spans.shape[0]):
        d = Diamond()
        d.low = boxes[2 * k]
        d.high = boxes[2 * k + 1]
        in_frame = wp.where(subtree.frustum_class == FADED, 0, 1)
        heights2, edges2 = finest_in(before, asked.slopes, d, in_frame)
        heights_now2, edges_now2 = finest_in(asked.view, asked.slopes, d, in_frame)
        spans[k, 0] = wp.sqrt(heights2)
        spans[k, 1] = wp.sqrt(heights_now2)
        spans[k, 2] = wp.sqrt(edges2)
        spans[k, 3] = wp.sqrt(edges_now2)
        subtree.fine = wp.min(subtree.fine, spans[k, wp.where(asked.measures_edges == 1, 2, 0)])
        subtree.coarse = wp.max(subtree.coarse, spans[k, 0])
    least, most, valid = footprint_change(asked.view, motion, asked.measures_edges, subtree)
    change[0] = least
    change[1] = most
    change[2] = wp.float64(valid)
