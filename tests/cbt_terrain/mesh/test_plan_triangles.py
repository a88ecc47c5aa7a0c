# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles in plan find the points that they cover."""

from fractions import Fraction

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.mesh.outline import counter_clockwise
from adaptive_terrain.cbt_terrain.mesh.plan_triangles import PlanTriangles


def is_in(triangle, point) -> bool:
    """Return whether a point is in a triangle or on its border, by exact signs of areas."""
    (u, v), corners = map(Fraction, point), [tuple(map(Fraction, corner)) for corner in triangle]
    areas = [
        (qx - px) * (v - py) - (qy - py) * (u - px)
        for (px, py), (qx, qy) in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    return min(areas) >= 0 or max(areas) <= 0


def scattered(random):
    return random.integers(0, 40, (50, 1, 2)) + random.integers(-6, 7, (50, 3, 2))


def fan(random):
    """Return long thin triangles about a corner, each with a wide box."""
    angle = np.linspace(0.1, 1.5, 60)
    ring = np.rint(1000 * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return np.stack([0 * ring[:-1], ring[:-1], ring[1:]], axis=1)


def one(_random):
    return np.array([[[0, 0], [7, 1], [2, 5]]])


@pytest.mark.parametrize("make", [scattered, fan, one])
def test_points_in_any_of_the_triangles_are_covered(make):
    """Corners, points on sides and points outside the grid of buckets are among them."""
    random = np.random.default_rng(4)
    triangles = counter_clockwise(make(random).astype(np.float64))
    low, high = triangles.min(axis=(0, 1)) - 3, triangles.max(axis=(0, 1)) + 3
    points = np.concatenate([random.integers(low, high, (150, 2)), triangles[:9, 0], triangles[:9, :2].mean(axis=1)])
    expected = [any(is_in(triangle, point) for triangle in triangles) for point in points]
    found = PlanTriangles(triangles).cover(points)
    assert found.tolist() == expected and 0 < sum(expected) < len(points)


def test_no_triangles_cover_nothing():
    points = np.zeros((3, 2))
    assert PlanTriangles(np.empty((0, 3, 2))).cover(points).tolist() == [False] * 3
    assert not len(PlanTriangles(np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])).cover(points[:0]))
