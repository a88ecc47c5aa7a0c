# SPDX-License-Identifier: GPL-3.0-or-later
"""Map from the triangles of a cut surface to the triangles of the whole surface that they are pieces of."""

from dataclasses import dataclass

import numpy as np

from .surface import Surface

ROUNDED = 4 * float(np.finfo(np.float32).eps)  # rounding error of a corner, as a fraction of the largest coordinate


@dataclass(frozen=True)
class Pieces:
    """Triangles of a cut surface, sorted by the whole triangle that each is a piece of.

    `order` int64 [T]: triangles of `surface` in that order. `whole` int64 [T]: their whole triangles, ascending.
    """

    surface: Surface
    order: np.ndarray
    whole: np.ndarray

    @classmethod
    def of(cls, surface: Surface, whole: np.ndarray) -> "Pieces":
        """Sort the triangles of a cut surface by the whole triangle of which each is a piece.

        whole: number of that triangle, int64 [T].
        """
        order = np.argsort(whole, kind="stable")
        return cls(surface, order, whole[order])

    def at(self, whole: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the piece at each point: int64 [n], triangles of `surface`; -1 where there is none.

        A point is in the piece that it is deepest inside; it may be outside by the rounding error of corners.

        Args:
            whole: int64 [n], the whole triangle at each point, -1 beyond the raster.
            places: float64 [n, 2], metres.
        """
        # Pieces are sorted by their whole triangle: those of `whole` are first .. end - 1.
        first, end = (np.searchsorted(self.whole, whole, side=side) for side in ("left", "right"))
        pieces, depth = np.full(len(whole), -1), np.full(len(whole), -np.inf)
        for k in range(int((end - first).max(initial=0))):
            rows = np.flatnonzero(first + k < end)  # points with a k-th piece
            triangles = self.order[first[rows] + k]
            piece_depth = _depth(self.surface.positions[self.surface.triangles[triangles], :2], places[rows])
            deeper = piece_depth > depth[rows]
            pieces[rows[deeper]], depth[rows[deeper]] = triangles[deeper], piece_depth[deeper]
        slack = ROUNDED * float(np.abs(self.surface.positions[:, :2]).max(initial=0.0))
        return np.where(depth >= -slack, pieces, -1)


def middles(surface: Surface) -> np.ndarray:
    """Return the centroid of each triangle in plan, metres, as float64 [T, 2]."""
    return surface.positions[surface.triangles, :2].astype(np.float64).mean(axis=1)


def _depth(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return how deep points are inside counter-clockwise triangles, metres; negative outside.

    corners: float32 [n, 3, 2], metres. places: float64 [n, 2]. The depth is the smallest signed distance to a side's
    line.
    """
    corners = corners.astype(np.float64)
    sides, to_places = np.roll(corners, -1, axis=1) - corners, places[:, None] - corners
    across = sides[..., 0] * to_places[..., 1] - sides[..., 1] * to_places[..., 0]
    return (across / np.sqrt(sides[..., 0] * sides[..., 0] + sides[..., 1] * sides[..., 1])).min(axis=1)
