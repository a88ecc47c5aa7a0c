# SPDX-License-Identifier: GPL-3.0-or-later
"""Coherence from frame to frame: what a walk keeps of a subtree, and whether it still holds for a camera that moved.

All decisions below a triangle compare the span of a pixel with a number that no camera changes. So a subtree keeps its
*rooms*: by how much spans may fall or rise before any of them is decided otherwise (a slack, as the deferred priorities
of ROAM; Duchaineau et al. 1997). While they last the next frame copies the subtree's leaves; the mesh is the one that
a walk without memory gives.
"""

import warp as wp

from .diamond import larger, smaller
from .pixels import (
    CLEAR,
    ORTHOGRAPHIC,
    OUTSIDE,
    PERSPECTIVE,
    Asked,
    LocalView,
    least_of,
    most_of,
    steady_stand_of,
)

NEAR = wp.constant(wp.float64(1.01))  # with what `Motion.drift` may be
ROUNDED = wp.constant(wp.float64(1e-9))  # relative: far above what rounding does to spans


@wp.struct
class Subtree:
    """The leaves below a triangle, where a walk has written them, and what they may bear."""

    cell: wp.uint64  # first deepest cell, all squares in a row
    depth: wp.int32
    stands: wp.int32  # in the frustum or outside: CLEAR or OUTSIDE
    leaves: wp.int32
    vertices: wp.int32  # new ones
    edges: wp.int32
    first_leaf: wp.int64  # entries in the arrays of the walk
    first_vertex: wp.int64
    low: wp.vec3d  # the box of all diamonds in it, metres of the terrain's space
    high: wp.vec3d
    fine: wp.float64  # spans of a pixel in any of their boxes: from this, metres,
    coarse: wp.float64  # to this
    fall: wp.float64  # they may fall by less than this
    rise: wp.float64  # ... and rise
    stopped: wp.int32  # 1: one of its leaves is too coarse at the deepest level that there may be


@wp.struct
class Motion:
    """How the view has moved since subtrees were kept."""

    eye: wp.vec3d  # before, as in LocalView
    depth: wp.vec4d
    step: wp.float64  # metres of camera space that the eye has moved
    ratio: wp.float64  # span of a pixel at unit depth over what it was
    drift: wp.float64  # part by which the lengths may have changed that spans are made of and compared with


@wp.func
def weighed(view: LocalView, v: wp.vec3d) -> wp.float64:
    """Length in camera space, metres."""
    return wp.sqrt(view.weight[0] * (v[0] * v[0]) + view.weight[1] * (v[1] * v[1]) + view.weight[2] * (v[2] * v[2]))


@wp.func
def change_of(view: LocalView, motion: Motion, low: wp.vec3d, high: wp.vec3d):
    """By how much, least and most, depths or distances have grown in any box inside this one, metres; valid or not.

    A span goes with the larger of the least depth in a box and of the least distance times a cosine. Depths change
    linearly. The distance of a point p from eyes a and b: its change varies over p by 2 |a - b| / (|p - a| + |p - b|)
    a metre at most.
    """
    half = wp.float64(0.5)
    centre = half * (low + high)
    reach = half * (high - low)
    radius = weighed(view, reach)
    before = weighed(view, centre - motion.eye)
    now = weighed(view, centre - view.eye)
    apart = before + now - wp.float64(2.0) * radius
    nearest = smaller(before, now) - radius
    valid = wp.int32(1)
    if nearest <= radius or nearest * nearest <= NEAR * view.near2:
        valid = 0
    spread = wp.float64(2.0) * radius * motion.step / apart
    least = now - before - spread
    most = now - before + spread
    if view.kind == PERSPECTIVE:
        cosine = wp.sqrt(view.cosine2)
        change = view.depth - motion.depth
        least = smaller(least * cosine, least_of(change, low, high))
        most = larger(most * cosine, most_of(change, low, high))
    return least, most, valid


@wp.func
def span_change(view: LocalView, motion: Motion, kept: Subtree):
    """By how much, least and most, spans have grown in any box of the subtree, metres; and whether that is known."""
    least = wp.float64(0.0)
    most = wp.float64(0.0)
    known = wp.int32(1)
    if view.kind != ORTHOGRAPHIC:
        least, most, known = change_of(view, motion, kept.low, kept.high)
    coarser2 = wp.float64(1.0)
    if kept.stands == OUTSIDE:
        coarser2 = view.off_screen2
    span = wp.sqrt(view.pixel2) * wp.sqrt(coarser2)
    growth = motion.ratio - wp.float64(1.0)
    # Spans drift, and so do those at which diamonds are decided otherwise.
    rounded = (ROUNDED + wp.float64(4.0) * motion.drift) * kept.coarse
    least = least * span + smaller(growth * kept.fine, growth * kept.coarse) - rounded
    most = most * span + larger(growth * kept.fine, growth * kept.coarse) + rounded
    return least, most, known


@wp.func
def carried(asked: Asked, motion: Motion, kept: Subtree, in_frame: wp.int32):
    """The subtree as it stands for the view that has moved, and whether it holds: all of it is decided as it was.

    in_frame: 1 where it is known that the frustum holds it.
    """
    least, most, holds = span_change(asked.view, motion, kept)
    kept.fall = kept.fall + least
    kept.rise = kept.rise - most
    rounded = ROUNDED * kept.coarse
    if not (kept.fall > rounded and kept.rise > rounded and kept.fine + least > rounded):
        holds = 0
    if holds == 1:
        stands = CLEAR
        if in_frame == 0:
            stands = steady_stand_of(asked.view, kept.low, kept.high)
        holds = wp.where(stands == kept.stands, 1, 0)
    if holds == 1:
        kept.fine = kept.fine + least
        kept.coarse = kept.coarse + most
    return kept, holds
