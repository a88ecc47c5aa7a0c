# SPDX-License-Identifier: GPL-3.0-or-later
"""The template of a meshlet: tables of the triangles into which an even number of bisections divides a leaf."""

from functools import cache

import numpy as np
import warp as wp

from ...kernels.mesh.meshlet import Template

# Corners and sides are stored left, apex, right at odd depths, and mirrored at even ones.
_MIRRORED_CORNERS, _MIRRORED_SIDES = [2, 1, 0], [1, 0, 2]

Barycentric = tuple[int, int, int]  # weights of left, apex and right, in n-ths


def _middle(p: Barycentric, q: Barycentric) -> Barycentric:
    """Return the midpoint of two points in barycentric coordinates, in units of 1 / segments."""
    return (p[0] + q[0]) // 2, (p[1] + q[1]) // 2, (p[2] + q[2]) // 2


@cache
def template(meshlet: int) -> Template:
    """Return the tables for 4**meshlet triangles a leaf; kernels/mesh/meshlet.py has the order of points and lines."""
    segments = 1 << meshlet
    triangles = [((segments, 0, 0), (0, segments, 0), (0, 0, segments))]
    for _ in range(2 * meshlet):
        triangles = [
            child
            for left, apex, right in triangles
            for middle in [_middle(left, right)]
            for child in ((left, middle, apex), (apex, middle, right))
        ]
    inner_points: dict[Barycentric, int] = {}
    inner_lines: dict[frozenset[Barycentric], tuple[int, Barycentric, Barycentric]] = {}

    def point(weights: Barycentric) -> int:
        """Return the number of a point: corners first, then points on sides, then inner ones as they are met.

        weights: its barycentric coordinates (of left, apex, right), in units of 1 / segments.
        """
        if segments in weights:
            return weights.index(segments)
        side = _side(weights)
        if side is not None:  # the weight of a corner of the side counts the points from the other one on
            return 3 + side * (segments - 1) + weights[(side + 1) % 3] - 1
        return 3 * segments + inner_points.setdefault(weights, len(inner_points))

    def line(p: Barycentric, q: Barycentric) -> int:
        """Return the number of a line between two points: segments of sides first, then inner ones as they are met."""
        side = _side(p, q)
        if side is not None:
            return side * segments + min(p[(side + 1) % 3], q[(side + 1) % 3])
        return 3 * segments + inner_lines.setdefault(frozenset((p, q)), (len(inner_lines), p, q))[0]

    corners = np.array([[point(b) for b in triangle] for triangle in triangles], np.int32)
    sides = np.array([[line(a, b), line(b, c), line(c, a)] for a, b, c in triangles], np.int32)

    def table(rows: list, dtype: type, shape: int | tuple[int, int]) -> wp.array:
        """Return rows of integers as an array for kernels."""
        return wp.array(np.array(rows, np.int32).reshape(shape), dtype=dtype, device="cpu")

    tables = Template()
    tables.segments, tables.levels, tables.triangles = segments, 2 * meshlet, len(triangles)
    tables.inner_points, tables.inner_lines = len(inner_points), len(inner_lines)
    tables.points, tables.lines = 3 * segments + tables.inner_points, 3 * segments + tables.inner_lines
    # first for leaves of even depth, which store corners and sides mirrored, then for leaves of odd depth
    tables.corners = table([corners[:, _MIRRORED_CORNERS], corners], wp.int32, -1)
    tables.sides = table([sides[:, _MIRRORED_SIDES], sides], wp.int32, -1)
    tables.weights = table([b[1:] for b in inner_points], wp.vec2i, (-1, 2))
    tables.ends = table([(point(p), point(q)) for _, p, q in inner_lines.values()], wp.int32, -1)
    return tables


def _side(*points: Barycentric) -> int | None:
    """Return the side that all points are on: 0 from left to apex, 1 from apex to right, 2 from right to left.

    None if no side contains them all.
    """
    for side in range(3):
        if all(b[(side + 2) % 3] == 0 for b in points):
            return side
    return None
