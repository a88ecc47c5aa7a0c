# SPDX-License-Identifier: GPL-3.0-or-later
"""Subtrees that one walk keeps and the next one takes (kernels/coherence.py), in lists along the curve."""

import warp as wp

from .bounds import Bounds
from .coherence import CROSSED, Subtree, stand_of
from .criterion import Asked, Diamond, coarsest
from .unchecked import copy_leaves, copy_points, copy_words, put_word
from .walk_state import Walk

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
def flush(w: Walk, words: wp.int64, word: wp.int64, bits: wp.uint64) -> wp.int64:
    """Write the word of the tree that is at hand, if there is one (not -1); returns how many words there are."""
    if word >= wp.int64(0):
        if words < w.leaf_capacity:
            put_word(w.word_index, w.word_bits, w.leaf_base + words, word, bits)
        words += wp.int64(1)
    return words


@wp.func
def take(w: Walk, subtree: Subtree, leaves: wp.int64, vertices: wp.int64, words: wp.int64):
    """Copy what the last frame has written of a subtree behind what there is."""
    if leaves + wp.int64(subtree.leaves) <= w.leaf_capacity:
        copy_leaves(w.last_code, subtree.first_leaf, subtree.leaves, w.code, w.leaf_base + leaves)
        copy_points(w.last_point, subtree.first_vertex, subtree.vertices, w.point, w.leaf_base + vertices)
        first = w.leaf_base + words
        copy_words(
            w.last_word_index, w.last_word_bits, subtree.first_word, subtree.words, w.word_index, w.word_bits, first
        )


@wp.func
def keep_taken(w: Walk, subtree: Subtree, at: wp.int64, leaves: wp.int64, vertices: wp.int64, words: wp.int64):
    """Keep what `take` has copied for the next frame too; returns how many are kept."""
    if at < w.room:
        subtree.first_leaf = w.leaf_base + leaves
        subtree.first_vertex = w.leaf_base + vertices
        subtree.first_word = w.leaf_base + words
        w.kept[wp.int64(w.slot) * w.room + at] = subtree
        at += wp.int64(1)
    return at


@wp.func
def open_subtree(
    asked: Asked, w: Walk, at: wp.int64, cell: wp.uint64, depth: wp.int32, diamond: Diamond, span: wp.float64
):
    """Begin to keep the subtree below a triangle whose diamond is measured; span: metres of a pixel, the finest."""
    if at < w.room:
        entry = wp.int64(w.slot) * w.room + at
        coarse2, _inside = coarsest(asked, diamond, 0)
        w.kept[entry].cell = cell
        w.kept[entry].depth = depth
        w.kept[entry].stands = stand_of(asked.view, diamond.low, diamond.high)
        w.kept[entry].low = diamond.low
        w.kept[entry].high = diamond.high
        w.kept[entry].fine = span
        w.kept[entry].coarse = wp.sqrt(coarse2)


@wp.func
def close_subtree(
    w: Walk,
    at: wp.int64,
    first_leaf: wp.int64,
    first_vertex: wp.int64,
    first_word: wp.int64,
    leaves: wp.int64,
    vertices: wp.int64,
    edges: wp.int64,
    words: wp.int64,
    fall: wp.float64,
    rise: wp.float64,
    most: Bounds,
) -> wp.int64:
    """End the subtree that was opened, with where it begins and how much there is; returns how many are kept."""
    if at < w.room:
        entry = wp.int64(w.slot) * w.room + at
        w.kept[entry].leaves = wp.int32(leaves)
        w.kept[entry].vertices = wp.int32(vertices)
        w.kept[entry].edges = wp.int32(edges)
        w.kept[entry].words = wp.int32(words)
        w.kept[entry].first_leaf = w.leaf_base + first_leaf
        w.kept[entry].first_vertex = w.leaf_base + first_vertex
        w.kept[entry].first_word = w.leaf_base + first_word
        w.kept[entry].fall = fall
        w.kept[entry].rise = rise
        w.kept[entry].most = most
        if w.kept[entry].stands != CROSSED:
            at += wp.int64(1)
    return at
