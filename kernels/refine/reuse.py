# SPDX-License-Identifier: GPL-3.0-or-later
"""Reuse of subtrees from the last frame (coherence.py decides which are valid), and the lists for the next frame.

A subtree is all leaves below a triangle, contiguous along the curve. While it is being cached it is *open*; at most one
is. `cell`: number of a deepest triangle along the curve over all squares, by which subtrees are located and ordered.

`w`: the slice's Walk. `q`: its current square. `c`: its cursor. `n`: its counts so far. `r`: the last frame's
subtrees and the slice's lists. `slot`: number of the slice. `criterion`: limits of errors and edges, and the views.

`r.cursor[slot]` has the next subtree of the last frame along the curve (`next`: its entry; `cell`, `depth`, `leaves`),
the `count` of subtrees cached so far, and the cell at which the open one ends (`end`; NOWHERE: none is open). The list
of a slice has `r.room` entries from slot * r.room on. Margins `fall` and `rise`: metres by which pixel footprints may
shrink and grow before a decision changes. `first_leaf`, `first_vertex`: entries in the frame's words and points.
"""

import warp as wp

from ..unchecked import copy_codes, copy_items
from .block import MAX_BISECTIONS
from .coherence import Subtree, frustum_class_of, update_margins
from .diamond import smaller
from .emit import can_copy_block
from .interval import DOUBT, REUSED, Limits, LodInterval, MeasuredDiamond, rise_to_turn, too_coarse
from .local_view import CLEAR, CROSSED
from .pixels import CriterionArrays, coarsest
from .reuse_state import Reuse, ReuseCursor
from .runs import NOT_CLEAR
from .steps import STOPPED, size_of
from .walk_state import Cursor, Square, Walk, Written

NOWHERE = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # a cell behind all others: there is no subtree
# Cache a subtree once its root error is at most ERRORS_CACHED times its leaf error. Prefer larger subtrees over ones
# with fewer than FEW_LEAVES leaves. A flight over rough ground with 1 M leaves reuses 77 % of them at 16 times, 88 % at
# 8 and 90 % at 6.
ERRORS_CACHED = wp.constant(wp.float64(8.0))
FEW_LEAVES = wp.constant(8)
LAST_LEVELS = wp.constant(6)  # levels above the deepest leaves in which a subtree may begin whatever its errors are


@wp.func
def move_cursor(r: Reuse, slot: wp.int32, after: wp.int64):
    """Move the cursor of slice `slot` to the subtree that follows entry `after` in the last frame's lists.

    after: -1 for the first subtree. Behind the last one, the cursor's cell is NOWHERE.
    """
    entry = after + wp.int64(1)
    list_number = wp.int32(entry / r.last_room)
    while list_number < r.last_slots and entry - wp.int64(list_number) * r.last_room >= r.last_counts[list_number]:
        list_number += 1
        entry = wp.int64(list_number) * r.last_room
    r.cursor[slot].next = entry
    r.cursor[slot].cell = NOWHERE
    if list_number < r.last_slots:
        r.cursor[slot].cell = r.last_cached[entry].cell
        r.cursor[slot].depth = r.last_cached[entry].depth
        r.cursor[slot].leaves = r.last_cached[entry].leaves


@wp.func
def begin_reuse(r: Reuse, slot: wp.int32):
    """Start the cursor of slice `slot` at the first subtree of the last frame, with empty lists for the next frame."""
    r.cursor[slot] = ReuseCursor()
    r.cursor[slot].end = NOWHERE
    move_cursor(r, slot, wp.int64(-1))


@wp.func
def end_reuse(r: Reuse, slot: wp.int32):
    """Write how many subtrees slice `slot` has cached, and how many leaves and runs of points it has reused."""
    r.cached_counts[slot] = r.cursor[slot].count
    r.reused[slot] = r.cursor[slot].reused
    r.point_run_counts[slot] = r.cursor[slot].point_runs


@wp.func
def note_reused(r: Reuse, slot: wp.int32, subtree: Subtree, leaf: wp.int64, point: wp.int64):
    """List a reused subtree's points in `r.point_runs`, and its leaves in `r.same`; later passes need not redo them.

    The displacement of points copies the runs' positions, the update of the tree leaves out the same leaves. leaf,
    point: entries in `Walk.code` and `Walk.point` where they were copied to. Subtrees beyond the `r.room` entries of a
    list are processed as new ones.
    """
    count = r.cursor[slot].point_runs
    if count < r.room:
        entry = wp.int64(slot) * r.room + count
        r.point_runs[entry].first = point
        r.point_runs[entry].before = subtree.first_vertex
        r.point_runs[entry].count = wp.int64(subtree.vertices)
        r.point_runs[entry].coarse = subtree.coarse
        # The subtree's box contains those of all deeper diamonds in it.
        r.point_runs[entry].clear_below = wp.where(subtree.frustum_class == CLEAR, subtree.depth, NOT_CLEAR)
        r.same[entry].first = leaf
        r.same[entry].count = subtree.leaves
        r.same[entry].depth = subtree.depth
        r.cursor[slot].point_runs = count + wp.int64(1)


@wp.func
def copy_subtree(w: Walk, r: Reuse, subtree: Subtree, n: Written):
    """Append the leaves and points of a cached subtree, as the last frame wrote them, to this frame's arrays.

    Nothing happens beyond the slice's capacity: `count_reused` counts them, and the caller walks again with more room.
    """
    if n.leaves + wp.int64(subtree.leaves) <= w.leaf_capacity:
        leaf = w.leaf_base + n.leaves
        point = w.leaf_base + n.vertices
        copy_codes(r.last_code, subtree.first_leaf, subtree.leaves, wp.uint16(0), w.code, leaf)  # no bits to add
        copy_items(r.last_point, subtree.first_vertex, subtree.vertices, w.point, point)
        note_reused(r, w.slot, subtree, leaf, point)


@wp.func
def limit_margins(r: Reuse, slot: wp.int32, fall: wp.float64, rise: wp.float64):
    """Limit the margins of the subtree that slice `slot` is caching.

    Its pixel footprints may fall by `fall` and rise by `rise` metres without changing a split decision.
    """
    entry = wp.int64(slot) * r.room + r.cursor[slot].count
    r.cached[entry].fall = smaller(r.cached[entry].fall, fall)
    r.cached[entry].rise = smaller(r.cached[entry].rise, rise)


@wp.func
def reuse_subtree(criterion: CriterionArrays, w: Walk, r: Reuse, q: Square, c: Cursor, n: Written) -> wp.int32:
    """Copy the leaves below the cursor's triangle from the last frame if they are cached and still valid.

    Returns REUSED, or DOUBT if they are not or if the slice ends within them. The copied subtree is also cached for the
    next frame, or narrows the margins of the open subtree that contains it. `count_reused` then adds its counts to n.
    """
    slot = w.slot
    cell = q.base + c.cell
    verdict = wp.int32(DOUBT)
    if r.cursor[slot].cell <= cell:
        # Pass over subtrees that end before the triangle or contain it.
        while r.cursor[slot].cell < cell or (r.cursor[slot].cell == cell and r.cursor[slot].depth < c.depth):
            move_cursor(r, slot, r.cursor[slot].next)
        if r.cursor[slot].cell == cell and r.cursor[slot].depth == c.depth:  # it is the triangle's
            subtree, is_valid = update_margins(
                criterion, r.motion, r.last_cached[r.cursor[slot].next], w.intervals[c.interval_index].in_frame
            )
            # It is valid, and all of it is in the slice.
            if is_valid == 1 and c.cell >= q.start and cell + size_of(w, c.depth) <= w.end_cell:
                verdict = REUSED
                copy_subtree(w, r, subtree, n)
                if r.cursor[slot].end != NOWHERE:  # inside an open subtree
                    limit_margins(r, slot, subtree.fall, subtree.rise)
                elif r.cursor[slot].count < r.room:
                    subtree.first_leaf = w.leaf_base + n.leaves
                    subtree.first_vertex = w.leaf_base + n.vertices
                    r.cached[wp.int64(slot) * r.room + r.cursor[slot].count] = subtree
                    r.cursor[slot].count = r.cursor[slot].count + wp.int64(1)
                # 1 if a leaf is too coarse at the depth limit
                w.counts[4 * slot + STOPPED] = w.counts[4 * slot + STOPPED] | wp.int64(subtree.stopped)
                r.cursor[slot].reused = r.cursor[slot].reused + wp.int64(subtree.leaves)
                r.cursor[slot].sizes = wp.vec3i(subtree.leaves, subtree.vertices, subtree.edges)
            move_cursor(r, slot, r.cursor[slot].next)
    return verdict


@wp.func
def count_reused(r: Reuse, slot: wp.int32, n: Written, verdict: wp.int32) -> Written:
    """Return the counts n plus those of the subtree that was reused last, if the verdict is REUSED."""
    sizes = wp.vec3i()
    if verdict == REUSED:
        sizes = r.cursor[slot].sizes
    n.leaves = n.leaves + wp.int64(sizes[0])
    n.vertices = n.vertices + wp.int64(sizes[1])
    n.edges = n.edges + wp.int64(sizes[2])
    return n


@wp.func
def may_begin_subtree(w: Walk, r: Reuse, q: Square, c: Cursor) -> wp.bool:
    """Return whether a cached subtree may begin at the cursor's triangle, so that its diamond must be measured.

    None begins inside a subtree that is open (being cached), above one of FEW_LEAVES or more leaves that the last frame
    has cached, at the depth limit, or without room in the list.
    """
    slot = w.slot
    may_begin = r.cursor[slot].end == NOWHERE and r.cursor[slot].count < r.room and c.depth < w.max_depth
    if may_begin:
        end = q.base + c.cell + size_of(w, c.depth)
        may_begin = r.cursor[slot].cell >= end or r.cursor[slot].leaves < FEW_LEAVES
    return may_begin


@wp.func
def open_subtree(
    criterion: CriterionArrays,
    w: Walk,
    r: Reuse,
    q: Square,
    c: Cursor,
    m: MeasuredDiamond,
    interval: LodInterval,
    n: Written,
):
    """Begin to cache the leaves below a split triangle in the slice's list, if it has only few bisections below it.

    Nothing happens in an open subtree, without room in the list, or if a leaf may have special bits (`can_copy_block`),
    as on a square's border. Few bisections: the error is at most ERRORS_CACHED times that of leaves, and edges need at
    most MAX_BISECTIONS, or the depth limit is near (LAST_LEVELS). m: its diamond. interval: the one below it. The
    margins begin at the change of footprints that intervals allow for (`r.slack`); `narrow_margins` narrows them, and
    `close_subtree` completes the entry. Until then entry STOPPED of the slice's counts says whether a leaf in this
    subtree alone is too coarse at the depth limit.
    """
    slot = w.slot
    opens = r.cursor[slot].end == NOWHERE and r.cursor[slot].count < r.room
    if opens:
        has_few_levels = (
            m.error_m <= ERRORS_CACHED * interval.leaf_up_to and interval.leaf_depth - c.depth <= MAX_BISECTIONS
        )
        opens = has_few_levels or w.max_depth - c.depth <= LAST_LEVELS
    if opens:
        frustum_class = frustum_class_of(criterion.view, m.diamond.low, m.diamond.high)
        if can_copy_block(w, q, c):
            r.cursor[slot].end = q.base + c.cell + size_of(w, c.depth)
            r.cursor[slot].before = n
            r.cursor[slot].stopped_before = w.counts[4 * slot + STOPPED]
            w.counts[4 * slot + STOPPED] = wp.int64(0)
            entry = wp.int64(slot) * r.room + r.cursor[slot].count
            coarse2, _edge2, _inside = coarsest(criterion, m.diamond, 0)  # 0: it may be outside the frame
            # Footprints of edges are finer.
            footprint = wp.sqrt(wp.where(criterion.measures_edges == 1, m.edge2, m.pixel2))
            r.cached[entry].cell = q.base + c.cell
            r.cached[entry].depth = c.depth
            r.cached[entry].frustum_class = frustum_class
            r.cached[entry].low = m.diamond.low
            r.cached[entry].high = m.diamond.high
            r.cached[entry].fine = footprint
            r.cached[entry].coarse = wp.sqrt(coarse2)
            r.cached[entry].fall = r.slack * footprint  # how far footprints may fall or rise
            r.cached[entry].rise = r.slack * footprint


@wp.func
def narrow_margins(criterion: CriterionArrays, limits: Limits, w: Walk, r: Reuse, m: MeasuredDiamond):
    """Limit the open subtree's margins, if one is open, to footprints at which diamond m gets the same verdict.

    A leaf stays one until footprints fall, a split diamond until they rise. One that exceeds the limit in metres is
    split at any footprint, and narrows no margin.
    """
    if r.cursor[w.slot].end != NOWHERE:
        inf = wp.float64(wp.inf)
        rise = rise_to_turn(limits, m)
        if not too_coarse(criterion, criterion.limit, m):  # a leaf
            limit_margins(r, w.slot, -rise, inf)
        elif not m.metres2 > criterion.limit * criterion.metres2:  # not split by metres
            limit_margins(r, w.slot, inf, rise)


@wp.func
def close_subtree(w: Walk, r: Reuse, cell: wp.uint64, n: Written):
    """Complete the entry of the open subtree, its leaves, vertices and edges, if it ends at `cell` or before.

    cell: the walk's position, counted over all squares. The entry is dropped if its box crosses the frustum's border.
    STOPPED of the slice's counts, 1 if a leaf is too coarse at the depth limit, was reset when the subtree was opened;
    its value from before is restored.
    """
    slot = w.slot
    if cell >= r.cursor[slot].end:
        entry = wp.int64(slot) * r.room + r.cursor[slot].count
        before = r.cursor[slot].before
        r.cached[entry].leaves = wp.int32(n.leaves - before.leaves)
        r.cached[entry].vertices = wp.int32(n.vertices - before.vertices)
        r.cached[entry].edges = wp.int32(n.edges - before.edges)
        r.cached[entry].first_leaf = w.leaf_base + before.leaves
        r.cached[entry].first_vertex = w.leaf_base + before.vertices
        r.cached[entry].stopped = wp.int32(w.counts[4 * slot + STOPPED])
        if r.cached[entry].frustum_class != CROSSED:
            r.cursor[slot].count = r.cursor[slot].count + wp.int64(1)
        r.cursor[slot].end = NOWHERE
        w.counts[4 * slot + STOPPED] = w.counts[4 * slot + STOPPED] | r.cursor[slot].stopped_before
