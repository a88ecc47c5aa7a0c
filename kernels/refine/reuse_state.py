# SPDX-License-Identifier: GPL-3.0-or-later
"""State of the cache of subtrees: the last frame's lists, and the lists for the next frame (see reuse.py)."""

import warp as wp

from ..tree.bitfield import SameLeaves
from .coherence import Motion, Subtree
from .runs import Run
from .walk_state import Written


@wp.struct
class ReuseCursor:
    """Positions of a slice in the last frame's list of subtrees and in the list that it writes."""

    next: wp.int64  # entry of the last frame's subtree that comes next along the curve
    cell: wp.uint64  # first cell, depth and leaves of that subtree
    depth: wp.int32
    leaves: wp.int32
    count: wp.int64  # subtrees cached for the next frame
    end: wp.uint64  # cell at which the open subtree ends; NOWHERE: no subtree is open
    before: Written  # counts when it was opened
    stopped_before: wp.int64  # the slice's entry STOPPED of `Walk.counts` when it was opened
    point_runs: wp.int64  # runs of reused points
    reused: wp.int64  # leaves
    sizes: wp.vec3i  # leaves, vertices and edges of the subtree that was reused last


@wp.struct
class Reuse:
    """Subtrees of the last frame, and the lists of subtrees and points that one slice writes for this frame."""

    slack: wp.float64  # fraction by which pixel footprints may change before an interval's verdict is in doubt
    motion: Motion  # of the view since the last frame
    cursor: wp.array(dtype=ReuseCursor)  # per slice
    room: wp.int64  # entries of each slice's lists; 0: nothing is cached
    cached: wp.array(dtype=Subtree)  # the list of a slice begins at entry slot * room
    cached_counts: wp.array(dtype=wp.int64)
    point_runs: wp.array(dtype=Run)  # of reused points, in lists like `cached`
    point_run_counts: wp.array(dtype=wp.int64)
    same: wp.array(dtype=SameLeaves)  # the leaves that were reused with these points
    reused: wp.array(dtype=wp.int64)  # per slice: leaves
    last_cached: wp.array(dtype=Subtree)  # lists of the last frame
    last_counts: wp.array(dtype=wp.int64)
    last_room: wp.int64
    last_slots: wp.int32  # 0: no subtree of the last frame may be reused
    last_code: wp.array(dtype=wp.uint16)  # leaves and points of the last frame
    last_point: wp.array(dtype=wp.vec2i)
