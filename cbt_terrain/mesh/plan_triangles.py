# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles in plan that are found by points, in buckets of a grid."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

MAX_ENTRIES = 16  # of buckets for each triangle, of long ones, too: memory


@dataclass(frozen=True)
class Buckets:
    """A grid of square buckets with the numbers of the triangles whose boxes reach into each.

    `low`: corner, float64 [2] metres. `side`: metres. `shape`: columns and rows. `first`: int64 [buckets + 1], each
    bucket's first entry in `numbers`, row by row.
    """

    low: np.ndarray
    side: float
    shape: np.ndarray
    first: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True, eq=False)
class PlanTriangles:
    """Triangles in plan: float64 [n, 3, 2] metres, counter-clockwise, each with an area."""

    triangles: np.ndarray

    def cover(self, points: np.ndarray) -> np.ndarray:
        """Return whether points, float64 [n, 2], are inside or on the border of any of the triangles, bool [n]."""
        is_covered = np.zeros(len(points), bool)
        if not len(self.triangles):
            return is_covered
        buckets = self._buckets
        cells = np.floor((points - buckets.low) / buckets.side)
        left = np.flatnonzero(((cells >= 0) & (cells < buckets.shape)).all(axis=1))  # points that are in none so far
        column, row = cells[left].astype(np.int64).T
        bucket = row * buckets.shape[0] + column
        entry, end = buckets.first[bucket], buckets.first[bucket + 1]
        while len(left):
            has_more = entry < end
            left, entry, end = left[has_more], entry[has_more], end[has_more]
            a, b, c = self.triangles[buckets.numbers[entry]].transpose(1, 2, 0)
            u, v = points[left].T
            is_inside = np.ones(len(left), bool)  # on the left of all sides
            for p, q in ((a, b), (b, c), (c, a)):
                is_inside &= (q[0] - p[0]) * (v - p[1]) >= (q[1] - p[1]) * (u - p[0])
            is_covered[left[is_inside]] = True
            left, entry, end = left[~is_inside], entry[~is_inside] + 1, end[~is_inside]
        return is_covered

    @cached_property
    def _buckets(self) -> Buckets:
        """Return about one bucket for each triangle; fewer if long triangles would have too many entries."""
        low, high = self.triangles.min(axis=1), self.triangles.max(axis=1)
        corner, extent = low.min(axis=0), high.max(axis=0) - low.min(axis=0)
        side = float(np.sqrt(extent[0] * extent[1] / len(low)))
        while True:
            # Both ends of a box go through the same rounding as points: no point is missed.
            first, last = (np.floor((ends - corner) / side).astype(np.int64) for ends in (low, high))
            counts = np.prod(last - first + 1, axis=1)
            if counts.sum() <= MAX_ENTRIES * len(low):
                break
            side *= 2.0
        shape = last.max(axis=0) + 1
        number = np.repeat(np.arange(len(low), dtype=np.int32), counts)
        index = np.arange(len(number)) - np.repeat(np.cumsum(counts) - counts, counts)  # of a box's buckets
        width = (last - first + 1)[:, 0][number]
        bucket = (first[number, 1] + index // width) * shape[0] + first[number, 0] + index % width
        order = np.argsort(bucket, kind="stable")
        starts = np.searchsorted(bucket[order], np.arange(shape[0] * shape[1] + 1))
        return Buckets(corner, side, shape, starts, number[order])
