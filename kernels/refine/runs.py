# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs: contiguous entries that this frame's arrays share with the last frame's."""

import warp as wp

NOT_CLEAR = wp.constant(1 << 30)  # no diamond is so deep


@wp.struct
class Run:
    """Cells or points that are contiguous in two streams."""

    first: wp.int64  # entry in the new stream
    before: wp.int64  # ... and in the old one
    count: wp.int64
    coarse: wp.float64  # coarsest footprint on the diamonds of points, metres; infinity: not known
    clear_below: wp.int32  # depth: the frustums contain the boxes of all deeper diamonds of points


@wp.struct
class Runs:
    """Lists of runs, each in the order of the new stream."""

    runs: wp.array(dtype=Run)  # list k from entry k * room on
    counts: wp.array(dtype=wp.int64)
    room: wp.int64
    lists: wp.int32
