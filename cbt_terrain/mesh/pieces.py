# SPDX-License-Identifier: GPL-3.0-or-later
"""Which triangles of a surface that was cut are pieces of which triangles of the whole one."""

from dataclasses import dataclass

import numpy as np

from .surface import Surface

ROUNDED = 4 * float(np.finfo(np.float32).eps)  # by which part of the largest coordinate a corner may be off its place


@dataclass(frozen=True)
class Pieces:
    """`order` int64 [T]: the triangles of `surface`, sorted by the number of the whole triangle that each is of.
    `whole` int64 [T]: those numbers, ascending."""

    surface: Surface
    order: np.ndarray
    whole: np.ndarray

    @classmethod
    def of(cls, surface: Surface, whole: np.ndarray) -> "Pieces":
        """`whole` int64 [T]: of each triangle the whole one that it is of."""
        order = np.argsort(whole, kind="stable")
        return cls(surface, order, whole[order])

    def at(self, whole: np.ndarray, places: np.ndarray) -> np.ndarray:
        """int64 [n]: of the pieces of the triangles `whole`, int64 [n], those at `places`, float64 [n, 2] in metres; -1
        where none is but for the rounding of their corners."""
        first, end = (np.searchsorted(self.whole, whole, side=side) for side in ("left", "right"))
        found, depth = np.full(len(whole), -1), np.full(len(whole), -np.inf)
        for k in range(int((end - first).max(initial=0))):
            rows = np.flatnonzero(first + k < end)
            triangles = self.order[first[rows] + k]
            inside = _depth(self.surface.positions[self.surface.triangles[triangles], :2], places[rows])
            deeper = inside > depth[rows]
            found[rows[deeper]], depth[rows[deeper]] = triangles[deeper], inside[deeper]
        slack = ROUNDED * float(np.abs(self.surface.positions[:, :2]).max(initial=0.0))
        return np.where(depth >= -slack, found, -1)


def middles(surface: Surface) -> np.ndarray:
    """float64 [T, 2]: the centroid of each triangle in plan."""
    return surface.positions[surface.triangles, :2].astype(np.float64).mean(axis=1)


def _depth(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How far inside of a triangle, float32 [n, 3, 2], counter-clockwise, a place is, metres; below 0: outside."""
    corners = corners.astype(np.float64)
    sides, there = np.roll(corners, -1, axis=1) - corners, places[:, None] - corners
    across = sides[..., 0] * there[..., 1] - sides[..., 1] * there[..., 0]
    return (across / np.sqrt(sides[..., 0] * sides[..., 0] + sides[..., 1] * sides[..., 1])).min(axis=1)
