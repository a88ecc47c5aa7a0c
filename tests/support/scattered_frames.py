# SPDX-License-Identifier: GPL-3.0-or-later
"""A scatter in a sequence of frames with one history."""

from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.scatter.points import ScatterRequest, place_points


class ScatteredFrames:
    """A scatter on a placed field."""

    def __init__(self, field, scatter, *scale, threads: int | None = None):
        self.field, self.scatter, self.threads = field, scatter, threads
        self.placed = dict(zip(("vertical_scale", "vertical_offset"), scale, strict=False))
        self.history = FrameHistory()

    def points(self, views=(), placement=None, horizon=None):
        """Return the points of the next frame."""
        request = ScatterRequest(self.scatter, views, placement, **self.placed, horizon=horizon)
        return place_points(self.field, request, self.history, self.threads)
