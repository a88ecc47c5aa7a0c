# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs: contiguous entries that this frame's arrays share with the last frame's."""

import warp as wp

NOT_CLEAR = wp.constant(1 << 30)  # no diamond is so deep


@wp.struct
class Run:
    """Points that are contiguous in this frame's array and in the last frame's."""

    first: wp.int64  # entry in this frame's array
    before: wp.int64  # ... and in the last frame's
    count: wp.int64
    coarse: wp.float64  # coarsest footprint on the diamonds of points, metres; infinity: not known
    clear_below: wp.int32  # depth: the frustums contain the boxes of all deeper diamonds of points


@wp.struct
class Runs:
    """Lists of runs, each in the order of this frame's array."""

    runs: wp.array(dtype=Run)  # list k from entry k * room on
    counts: wp.array(dtype=wp.int64)  # runs in each list
    room: wp.int64  # entries for each list
    lists: wp.int32  # number of lists
