# SPDX-License-Identifier: GPL-3.0-or-later
"""The invariants find every kind of fault: a good mesh is broken in each way that they forbid."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from fields import rough
from invariants import assert_invariants, with_arrays

FIELD = rough(17, 33)


def changed(surface, name, at, value):
    array = surface.arrays()[name].copy()
    array[at] = value
    return with_arrays(surface, **{name: array})


def without_last(surface):
    """Remove the last triangle but keep its vertices and edges, which makes a hole."""
    return with_arrays(
        surface,
        corner_verts=surface.corner_verts[:-3],
        corner_edges=surface.corner_edges[:-3],
        terrain_level=surface.level[:-1],
    )


def turned(surface):
    """Reverse the corners of one triangle, which then faces down."""
    corners = surface.triangles.copy()
    corners[5] = corners[5, [0, 2, 1]]
    sides = surface.corner_edges.reshape(-1, 3).copy()
    sides[5] = sides[5, [2, 1, 0]]
    return replace(surface, corner_verts=corners.ravel(), corner_edges=sides.ravel())


def torn(surface):
    """Give one corner a separate vertex at the same position."""
    count = len(surface.positions)
    old = surface.corner_verts[30]
    corners = surface.corner_verts.copy()
    corners[30] = count
    return with_arrays(
        surface,
        corner_verts=corners,
        **{
            name: np.vstack([getattr(surface, name), getattr(surface, name)[old]])
            for name in ("positions", "normals", "uv")
        },
    )


BROKEN = {
    "I1 a height that is not finite": lambda s: changed(s, "positions", (7, 2), np.nan),
    "I1 a normal of another length": lambda s: changed(s, "normals", (7, 2), 0.5 + s.normals[7, 2]),
    "I1 a normal that is not finite": lambda s: changed(s, "normals", 7, np.inf),
    "I1 a texture coordinate that is not finite": lambda s: changed(s, "uv", (7, 0), np.nan),
    "I2 an edge that joins other corners": lambda s: changed(s, "edges", 9, s.edges[10]),
    "I2 a side that belongs to another edge": lambda s: changed(
        s, "corner_edges", 4, (s.corner_edges[4] + 1) % len(s.edges)
    ),
    "I2, I3 a hole": without_last,
    "I3 a triangle that faces down": turned,
    "I4 a leaf of another depth": lambda s: changed(s, "terrain_level", 3, s.level[3] + 1),
    "I5 a vertex twice": torn,
    "I5, I6 two vertices at one place": lambda s: changed(s, "positions", 8, s.positions[9]),
    "I6 a vertex on the wrong side": lambda s: changed(s, "positions", (8, 0), -s.positions[8, 0] + 3.0),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_broken_mesh_is_found(how):
    surface = Terrain(FIELD, 1).update(Criterion(error_px=0.0, error_m=5.0)).surface
    assert_invariants(surface, FIELD.lattice)
    with pytest.raises(AssertionError):
        assert_invariants(BROKEN[how](surface), FIELD.lattice)
