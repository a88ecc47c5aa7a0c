# SPDX-License-Identifier: GPL-3.0-or-later
"""Cut sides for the inside of an outline in plan.

A convex outline of few lines is cut line by line, exactly. Of any other the value is the distance to it: the border
follows the outline where it is straight across a triangle, and rounds its corners off by less than a triangle.
"""

from functools import partial

import numpy as np

from ..view.linear import lengths
from .cut import Side
from .plan_triangles import PlanTriangles
from .surface import Surface

# A convex outline with at most this number of lines is cut line by line.
MAX_LINES = 32
# Rounding error, as a fraction of the outline's size.
SAME = 1e-9
BLOCK = 1 << 20  # distances at a time


def inside(triangles: np.ndarray, surface: Surface) -> list[Side]:
    """Return sides that keep the part of `surface` inside `triangles` in plan, float64 [n, 3, 2] metres.

    Without a triangle that has an area, nothing is kept. The sides of a convex outline of few lines serve for any
    surface. Otherwise there is one, whose values are those of the vertices of `surface`, so it can cut only that.
    """
    triangles = counter_clockwise(triangles)
    border = outline(triangles) if len(triangles) else triangles
    if not len(border):
        return [Side(lambda positions: np.full(len(positions), -1.0))]
    lines = _lines(border)
    if len(lines) <= MAX_LINES and _holds_all(lines, border.reshape(-1, 2)):
        return [Side(partial(_from_line, line)) for line in lines]
    values = _distances(triangles, border, surface)
    return [Side(lambda _positions: values)]


def counter_clockwise(triangles: np.ndarray) -> np.ndarray:
    """Return the triangles, float64 [n, 3, 2], that have an area, all counter-clockwise."""
    (ux, uy), (vx, vy) = (triangles[:, k].T - triangles[:, 0].T for k in (1, 2))
    area2 = ux * vy - uy * vx
    return np.where((area2 < 0)[:, None, None], triangles[:, ::-1], triangles)[area2 != 0]


def outline(triangles: np.ndarray) -> np.ndarray:
    """Return float64 [m, 2, 2]: the edges with a counter-clockwise triangle on their left side only, each once.

    triangles: float64 [n, 3, 2], counter-clockwise, at least one. Ends within SAME of the extent are one point.
    """
    edges = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    grid = np.rint((edges - edges.min(axis=(0, 1))) / (SAME * np.ptp(edges, axis=(0, 1)).max())).astype(np.int64)
    _, point_number = np.unique(grid.reshape(-1, 2), axis=0, return_inverse=True)
    a, b = point_number.reshape(-1, 2).T.astype(np.int64)
    count = point_number.max() + 1
    # an edge is inside if its reverse is there, too
    forward, first = np.unique(a * count + b, return_index=True)
    return edges[first[~np.isin(forward, b * count + a)]]


def _lines(border: np.ndarray) -> np.ndarray:
    """Return float64 [n, 3]: the edges' lines (a, b, c), each once; a x + b y + c is the distance to the left.

    border: ends of the edges, float64 [n, 2 ends, x y].
    """
    along = border[:, 1] - border[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / lengths(along.T)[:, None]
    lines = np.concatenate([normal, -np.sum(normal * border[:, 0], axis=1, keepdims=True)], axis=1)
    size = np.abs(border).max()
    # Directions of short edges are off by far more than their ends.
    rounded = np.rint(lines / (1e3 * SAME * np.array([1.0, 1.0, size])))
    return lines[np.sort(np.unique(rounded, axis=0, return_index=True)[1])]


def _from_line(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the signed distance of points, float64 [n, 2], to a line (a, b, c), positive on its left, metres."""
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    return line[0] * x + line[1] * y + line[2]


def _holds_all(lines: np.ndarray, points: np.ndarray) -> bool:
    """Return whether all points, float64 [n, 2], are to the left of all lines, except for rounding.

    Then the outline with these lines and points is convex. lines: float64 [m, 3], from `_lines`.
    """
    min_distance = -1e3 * SAME * np.abs(points).max()
    return all((_from_line(line, points) >= min_distance).all() for line in lines)


def _distances(triangles: np.ndarray, border: np.ndarray, surface: Surface) -> np.ndarray:
    """Return float64 [V]: distance of each vertex to the border in metres, positive inside.

    triangles: those of the outline, float64 [n, 3, 2], counter-clockwise. border: its edges, float64 [m, 2 ends, x y].
    Exact for vertices of triangles with corners inside and outside; all others have the right sign and a magnitude of
    1.
    """
    points = surface.positions[:, :2].astype(np.float64)
    is_inside = PlanTriangles(triangles).cover(points)
    values = np.where(is_inside, 1.0, -1.0)
    corners = is_inside[surface.triangles]
    beside_border = np.unique(surface.triangles[corners.any(axis=1) & ~corners.all(axis=1)])
    start, along = border[:, 0], border[:, 1] - border[:, 0]
    for block in np.array_split(beside_border, 1 + len(beside_border) * len(border) // BLOCK):
        from_start = points[block][:, None] - start
        # how far along each segment its point is that is nearest to a vertex, 0 .. 1
        t = np.clip(np.sum(from_start * along, axis=2) / np.sum(along * along, axis=1), 0.0, 1.0)
        from_start -= t[:, :, None] * along
        values[block] *= np.sqrt(np.sum(from_start * from_start, axis=2).min(axis=1))
    return values
