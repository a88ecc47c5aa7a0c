# SPDX-License-Identifier: GPL-3.0-or-later
"""Subtrees that one walk keeps and the next one takes (kernels/refine/coherence.py), in lists along the curve."""

import warp as wp

from ..unchecked import copy_codes, copy_items
from .band import DOUBT, TAKEN, Band, Limits, Measured, too_coarse, turning_span
from .block import MAX_BISECTIONS
from .coherence import Subtree, carried
from .diamond import smaller
from .emit import stands_alone
from .pixels import CROSSED, Asked, coarsest, steady_stand_of
from .steps import size_of
from .walk_state import Cursor, Keeper, Square, Walk, Written

NOWHERE = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))
# A subtree is kept from where errors are up to so many times those of its leaves; of fewer leaves rather a larger one.
# Of a flight over rough ground, 1 M leaves, 77 % are taken from the last frame at 16 times, 88 % at 8, 90 % at 6.
ERRORS_KEPT = wp.constant(wp.float64(8.0))
FEW_LEAVES = wp.constant(8)
LAST_LEVELS = wp.constant(6)  # above the deepest leaves a subtree may begin whatever its errors are


@wp.func
def seek(w: Walk, after: wp.int64):
    """Find the subtree that the last frame's lists have after entry `after`; -1: the first."""
    i = after + wp.int64(1)
    slot = wp.int32(i / w.last_room)
    while slot < w.last_slots and i - wp.int64(slot) * w.last_room >= w.last_counts[slot]:
        slot += 1
        i = wp.int64(slot) * w.last_room
    w.keeper[w.slot].next = i
    w.keeper[w.slot].cell = NOWHERE
    if slot < w.last_slots:
        w.keeper[w.slot].cell = w.last_kept[i].cell
        w.keeper[w.slot].depth = w.last_kept[i].depth
        w.keeper[w.slot].leaves = w.last_kept[i].leaves


@wp.func
def begin_keeping(w: Walk):
    w.keeper[w.slot] = Keeper()
    w.keeper[w.slot].end = NOWHERE
    seek(w, wp.int64(-1))


@wp.func
def note_points(w: Walk, first: wp.int64, before: wp.int64, points: wp.int64, coarse: wp.float64):
    """Note a run of points that are taken; where there is no room for it, they count as new."""
    count = w.keeper[w.slot].point_runs
    if count < w.room:
        entry = wp.int64(w.slot) * w.room + count
        w.point_runs[entry].first = first
        w.point_runs[entry].before = before
        w.point_runs[entry].count = points
        w.point_runs[entry].coarse = coarse
        w.keeper[w.slot].point_runs = count + wp.int64(1)


@wp.func
def copy_taken(w: Walk, subtree: Subtree, n: Written):
    """Copy what the last frame has written of a subtree behind what there is."""
    if n.leaves + wp.int64(subtree.leaves) <= w.leaf_capacity:
        leaf = w.leaf_base + n.leaves
        point = w.leaf_base + n.vertices
        copy_codes(w.last_code, subtree.first_leaf, subtree.leaves, wp.uint16(0), w.code, leaf)
        copy_items(w.last_cell, subtree.first_leaf, subtree.leaves, w.cell, leaf)
        copy_items(w.last_point, subtree.first_vertex, subtree.vertices, w.point, point)
        note_points(w, point, subtree.first_vertex, wp.int64(subtree.vertices), subtree.coarse)


@wp.func
def narrow(w: Walk, fall: wp.float64, rise: wp.float64):
    """Of the subtree that is open: spans may fall and rise by no more than this."""
    entry = wp.int64(w.slot) * w.room + w.keeper[w.slot].count
    w.kept[entry].fall = smaller(w.kept[entry].fall, fall)
    w.kept[entry].rise = smaller(w.kept[entry].rise, rise)


@wp.func
def take(asked: Asked, w: Walk, q: Square, c: Cursor, n: Written) -> wp.int32:
    """Copy a triangle's leaves from the last frame if that has kept them and they hold: TAKEN; else DOUBT."""
    k = w.slot
    at = q.base + c.cell
    verdict = wp.int32(DOUBT)
    if w.keeper[k].cell <= at:
        while w.keeper[k].cell < at or (w.keeper[k].cell == at and w.keeper[k].depth < c.depth):
            seek(w, w.keeper[k].next)
        if w.keeper[k].cell == at and w.keeper[k].depth == c.depth:
            subtree, holds = carried(asked, w.motion, w.last_kept[w.keeper[k].next], w.bands[c.held].in_frame)
            if holds == 1 and c.cell >= q.start and at + size_of(w, c.depth) <= w.end_cell:
                verdict = TAKEN
                copy_taken(w, subtree, n)
                if w.keeper[k].end != NOWHERE:
                    narrow(w, subtree.fall, subtree.rise)
                elif w.keeper[k].count < w.room:
                    subtree.first_leaf = w.leaf_base + n.leaves
                    subtree.first_vertex = w.leaf_base + n.vertices
                    w.kept[wp.int64(k) * w.room + w.keeper[k].count] = subtree
                    w.keeper[k].count = w.keeper[k].count + wp.int64(1)
                w.keeper[k].stopped = w.keeper[k].stopped | subtree.stopped
                w.keeper[k].taken = w.keeper[k].taken + wp.int64(subtree.leaves)
                w.keeper[k].sizes = wp.vec3i(subtree.leaves, subtree.vertices, subtree.edges)
            seek(w, w.keeper[k].next)
    return verdict


@wp.func
def looks_for_subtree(w: Walk, q: Square, c: Cursor) -> wp.bool:
    """Whether a subtree may begin at this triangle: then its diamond is measured. On the way to one that the last frame
    has kept none does."""
    k = w.slot
    found = w.keeper[k].end == NOWHERE and w.keeper[k].count < w.room and c.depth < w.max_depth
    if found:
        end = q.base + c.cell + size_of(w, c.depth)
        found = w.keeper[k].cell >= end or w.keeper[k].leaves < FEW_LEAVES
    return found


@wp.func
def open_subtree(asked: Asked, w: Walk, q: Square, c: Cursor, m: Measured, band: Band, n: Written):
    """Begin to keep what is below a triangle that is split, if only few bisections are left."""
    k = w.slot
    opens = w.keeper[k].end == NOWHERE and w.keeper[k].count < w.room
    if opens:
        few = m.own <= ERRORS_KEPT * band.leaf_up_to and band.leaf_depth - c.depth <= MAX_BISECTIONS
        opens = few or w.max_depth - c.depth <= LAST_LEVELS
    if opens:
        stands = steady_stand_of(asked.view, m.diamond.low, m.diamond.high)
        if stands_alone(w, q, c):
            w.keeper[k].end = q.base + c.cell + size_of(w, c.depth)
            w.keeper[k].before = n
            w.keeper[k].stopped_before = w.keeper[k].stopped
            w.keeper[k].stopped = 0
            entry = wp.int64(k) * w.room + w.keeper[k].count
            coarse2, _inside = coarsest(asked, m.diamond, 0)
            span = wp.sqrt(m.pixel2)
            w.kept[entry].cell = q.base + c.cell
            w.kept[entry].depth = c.depth
            w.kept[entry].stands = stands
            w.kept[entry].low = m.diamond.low
            w.kept[entry].high = m.diamond.high
            w.kept[entry].fine = span
            w.kept[entry].coarse = wp.sqrt(coarse2)
            w.kept[entry].fall = w.slack * span
            w.kept[entry].rise = w.slack * span


@wp.func
def note_turning(asked: Asked, limits: Limits, w: Walk, m: Measured):
    """The decision on a diamond that was measured holds while spans do not pass that at which it turns."""
    if w.keeper[w.slot].end != NOWHERE:
        inf = wp.float64(wp.inf)
        away = turning_span(limits, m) - wp.sqrt(m.pixel2)
        if not too_coarse(asked, asked.limit, m):
            narrow(w, -away, inf)
        elif not m.metres2 > asked.limit * asked.metres2:
            narrow(w, inf, away)


@wp.func
def close_subtree(w: Walk, at: wp.uint64, n: Written):
    """End the subtree that is open if it ends at cell `at` or before."""
    k = w.slot
    if at >= w.keeper[k].end:
        entry = wp.int64(k) * w.room + w.keeper[k].count
        before = w.keeper[k].before
        w.kept[entry].leaves = wp.int32(n.leaves - before.leaves)
        w.kept[entry].vertices = wp.int32(n.vertices - before.vertices)
        w.kept[entry].edges = wp.int32(n.edges - before.edges)
        w.kept[entry].first_leaf = w.leaf_base + before.leaves
        w.kept[entry].first_vertex = w.leaf_base + before.vertices
        w.kept[entry].stopped = w.keeper[k].stopped
        if w.kept[entry].stands != CROSSED:
            w.keeper[k].count = w.keeper[k].count + wp.int64(1)
        w.keeper[k].end = NOWHERE
        w.keeper[k].stopped = w.keeper[k].stopped | w.keeper[k].stopped_before
