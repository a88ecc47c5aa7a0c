# SPDX-License-Identifier: GPL-3.0-or-later
"""Subtrees that one walk keeps and the next one takes (kernels/refine/coherence.py), in lists along the curve."""

import warp as wp

from ..unchecked import copy_cells, copy_codes, copy_points
from .band import Measured
from .bounds import Bounds
from .coherence import CROSSED, Subtree, stand_of
from .diamond import Asked, coarsest
from .sum_reduction import Run
from .walk_state import Walk, Written

wp.set_module_options({"enable_backward": False})

NOWHERE = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))


@wp.func
def next_kept(w: Walk, kept: wp.int64):
    """The subtree after entry `kept` of the last frame's lists (-1: the first): entry, cell, depth and leaves."""
    i = kept + wp.int64(1)
    slot = wp.int32(i / w.last_room)
    while slot < w.last_slots and i - wp.int64(slot) * w.last_room >= w.last_counts[slot]:
        slot += 1
        i = wp.int64(slot) * w.last_room
    cell = wp.uint64(NOWHERE)
    depth = wp.int32(0)
    leaves = wp.int32(0)
    if slot < w.last_slots:
        cell = w.last_kept[i].cell
        depth = w.last_kept[i].depth
        leaves = w.last_kept[i].leaves
    return i, cell, depth, leaves


@wp.func
def noted(
    w: Walk, runs: wp.array(dtype=Run), count: wp.int64, first: wp.int64, before: wp.int64, entries: wp.int64
) -> wp.int64:
    """Note a run of what is taken, with the last one if it goes on; returns how many there are.

    Where there is no room for another run, what is in it counts as new.
    """
    entry = wp.int64(w.slot) * w.room + count
    follows = wp.bool(False)
    if count > wp.int64(0):
        last = runs[entry - wp.int64(1)]
        follows = last.first + last.count == first and last.before + last.count == before
    if follows:
        runs[entry - wp.int64(1)].count = runs[entry - wp.int64(1)].count + entries
    elif count < w.room:
        runs[entry].first = first
        runs[entry].before = before
        runs[entry].count = entries
        count += wp.int64(1)
    return count


@wp.func
def take(w: Walk, subtree: Subtree, n: Written, runs: wp.int64, point_runs: wp.int64):
    """Copy what the last frame has written of a subtree behind what there is; returns how many runs of leaves and of
    points are noted."""
    if n.leaves + wp.int64(subtree.leaves) <= w.leaf_capacity:
        nothing = wp.uint16(0)
        first = w.leaf_base + n.leaves
        copy_codes(w.last_code, subtree.first_leaf, subtree.leaves, nothing, w.code, first)
        copy_cells(w.last_cell, subtree.first_leaf, subtree.leaves, w.cell, first)
        first_point = w.leaf_base + n.vertices
        copy_points(w.last_point, subtree.first_vertex, subtree.vertices, w.point, first_point)
        runs = noted(w, w.runs, runs, first, subtree.first_leaf, wp.int64(subtree.leaves))
        points = wp.int64(subtree.vertices)
        point_runs = noted(w, w.point_runs, point_runs, first_point, subtree.first_vertex, points)
    return runs, point_runs


@wp.func
def keep_taken(w: Walk, subtree: Subtree, count: wp.int64, n: Written) -> wp.int64:
    """Keep what `take` has copied for the next frame too; returns how many subtrees are kept."""
    if count < w.room:
        subtree.first_leaf = w.leaf_base + n.leaves
        subtree.first_vertex = w.leaf_base + n.vertices
        w.kept[wp.int64(w.slot) * w.room + count] = subtree
        count += wp.int64(1)
    return count


@wp.func
def open_subtree(asked: Asked, w: Walk, count: wp.int64, cell: wp.uint64, depth: wp.int32, m: Measured):
    """Begin to keep the subtree below a triangle whose diamond is measured."""
    if count < w.room:
        entry = wp.int64(w.slot) * w.room + count
        coarse2, _inside = coarsest(asked, m.diamond, 0)
        w.kept[entry].cell = cell
        w.kept[entry].depth = depth
        w.kept[entry].stands = stand_of(asked.view, m.diamond.low, m.diamond.high)
        w.kept[entry].low = m.diamond.low
        w.kept[entry].high = m.diamond.high
        w.kept[entry].fine = wp.sqrt(m.pixel2)
        w.kept[entry].coarse = wp.sqrt(coarse2)


@wp.func
def close_subtree(
    w: Walk, count: wp.int64, first: Written, n: Written, fall: wp.float64, rise: wp.float64, most: Bounds
) -> wp.int64:
    """End the subtree that was opened when `first` was written; returns how many are kept."""
    if count < w.room:
        entry = wp.int64(w.slot) * w.room + count
        w.kept[entry].leaves = wp.int32(n.leaves - first.leaves)
        w.kept[entry].vertices = wp.int32(n.vertices - first.vertices)
        w.kept[entry].edges = wp.int32(n.edges - first.edges)
        w.kept[entry].first_leaf = w.leaf_base + first.leaves
        w.kept[entry].first_vertex = w.leaf_base + first.vertices
        w.kept[entry].fall = fall
        w.kept[entry].rise = rise
        w.kept[entry].most = most
        if w.kept[entry].stands != CROSSED:
            count += wp.int64(1)
    return count
