# SPDX-License-Identifier: GPL-3.0-or-later
"""The reference refinement: no cracks, the smallest nested criterion, and the triangles of the product in its order."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.refine.reference import edges, middle, nested, refine, square
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough

DEPTH = 9
ROOTS = [root for column in range(3) for root in square(16.0 * column, 0.0, 16.0)]


@pytest.mark.parametrize("seed", range(4))
def test_a_nested_criterion_gives_a_mesh_without_cracks(seed):
    rng = np.random.default_rng(seed)
    wanted: dict = {}

    def is_split(vertex, longest):
        return wanted.setdefault(vertex, bool(rng.random() < 0.01 * longest))

    split = nested(ROOTS, DEPTH, is_split)
    leaves = refine(ROOTS, DEPTH, split)
    corners = {corner for leaf in leaves for corner in leaf}
    assert len(leaves) > 40 and all(split(vertex, 0.0) for vertex in wanted if wanted[vertex])
    uses = Counter(edge for leaf in leaves for edge in edges(leaf))
    assert max(uses.values()) == 2 and all(middle(*edge) not in corners for edge in uses)
    once = [tuple(edge) for edge, count in uses.items() if count == 1]
    assert all(a[1] == b[1] in (0.0, 16.0) or a[0] == b[0] in (0.0, 48.0) for a, b in once)
    squares = [int(min(x for x, _ in leaf) // 16.0) for leaf in leaves]
    joined = [bool(set(edges(a)) & set(edges(b))) for a, b in pairwise(leaves)]
    assert all(j for j, (a, b) in zip(joined, pairwise(squares), strict=True) if a == b)


def test_a_nested_criterion_is_left_as_it_is():
    def near(vertex, longest):
        return longest > 1.0 + 0.5 * np.hypot(vertex[0] - 7.0, vertex[1] - 3.0)

    once = nested(ROOTS, DEPTH, near)
    twice = nested(ROOTS, DEPTH, once)
    assert refine(ROOTS, DEPTH, once) == refine(ROOTS, DEPTH, twice) != refine(ROOTS, DEPTH, lambda *_: False)


@pytest.mark.parametrize("shape", [(33, 33), (33, 97)])
def test_the_product_makes_the_triangles_of_the_reference(shape):
    """From the mesh's vertices alone the reference finds every triangle, in the same order."""
    field = rough(*shape, relief=20.0)
    view = View.look((-60.0, -150.0, 60.0), (0, 0, 0), resolution=(640, 360))
    surface = Terrain(field, 2).update(Criterion(error_px=2.0), [view]).surface
    west, south, _, _ = field.lattice.rectangle()
    plan = (surface.positions[:, :2].astype(np.float64) - (west, south)) / (field.lattice.step_x, field.lattice.step_y)
    points = [tuple(point) for point in plan.tolist()]
    vertices = set(points)
    roots = [root for column in range((shape[1] - 1) // 32) for root in square(32.0 * column, 0.0, 32.0)]
    leaves = refine(roots, 40, lambda vertex, _longest: vertex in vertices)
    found = [{points[corner] for corner in triangle} for triangle in surface.triangles.tolist()]
    assert len(leaves) > 300 and found == [set(leaf) for leaf in leaves]
