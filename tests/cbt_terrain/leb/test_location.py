# SPDX-License-Identifier: GPL-3.0-or-later
"""Point location against the mesh: the triangle that is found holds the point, and no other does."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.leb.location import locate
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough

# One square; a row of squares; a padded square; padded on both sides in a grid.
SHAPES = [(33, 33), (17, 65), (50, 40), (11, 73)]
VIEW = View.look((0.0, -400.0, 120.0), (0, 0, 0), resolution=(640, 480))


def are_inside(surface, triangles, places, slack=1e-3) -> np.ndarray:
    """Return whether points [n, 2] are in triangles [n] of the mesh in plan, or within `slack` metres of them."""
    p = surface.positions[surface.triangles[triangles], :2].astype(np.float64)
    u, v = np.roll(p, -1, axis=1) - p, places[:, None] - p
    return ((u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]) / np.linalg.norm(u, axis=2) >= -slack).all(axis=1)


@pytest.mark.parametrize("meshlet", [0, 1, 3])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_the_triangle_at_a_place_holds_it(shape, meshlet):
    terrain = Terrain(rough(*shape), 2)
    surface = terrain.update(Criterion(error_px=1.0, meshlet=meshlet), [VIEW]).surface
    low, high = surface.positions.min(axis=0)[:2], surface.positions.max(axis=0)[:2]
    rng = np.random.default_rng(1)
    rims = rng.uniform(low, high, (40, 2))
    rims[:20, 0], rims[20:, 1] = high[0], high[1]
    places = np.concatenate([rng.uniform(low, high, (300, 2)), rims, surface.positions[::29, :2]])
    found = terrain.triangles_at(places)
    assert found.dtype == np.int64 and len(np.unique(found)) > 40
    assert are_inside(surface, found, places).all()
    assert (terrain.triangles_at(places[::-1]) == found[::-1]).all(), "asked again, in another order"
    assert terrain.triangles_at([[high[0] + 0.5, 0], [0, low[1] - 0.5], [np.nan, 0]]).tolist() == [-1, -1, -1]


def test_each_triangle_is_at_its_own_middle():
    for shape in SHAPES:
        terrain = Terrain(rough(*shape), 1)
        surface = terrain.update(Criterion(error_px=2.0), [VIEW]).surface
        middles = surface.positions[surface.triangles, :2].astype(np.float64).mean(axis=1)
        assert (terrain.triangles_at(middles) == np.arange(len(middles))).all()


def test_in_a_hole_there_is_no_triangle():
    samples = np.array(rough(50, 66).samples)
    samples[20:30, 30:44] = samples[0, 5] = samples[-1, -1] = np.nan
    field = from_array(samples, 10.0, holes=True)
    terrain = Terrain(field, 1)
    surface = terrain.update(Criterion(error_px=4.0), [VIEW]).surface
    middles = surface.positions[surface.triangles, :2].astype(np.float64).mean(axis=1)
    assert (terrain.triangles_at(middles) == np.arange(len(middles))).all()
    # In the raster's cells with a corner that is missing, and nowhere else, is nothing.
    cells = np.random.default_rng(3).uniform((0, 0), (65, 49), (600, 2))
    i, j = cells.astype(int).T
    in_hole = np.isnan([samples[j + dy, i + dx] for dy in (0, 1) for dx in (0, 1)]).any(axis=0)
    found = terrain.triangles_at((cells - (32.5, 24.5)) * 10.0)
    assert 20 < in_hole.sum() and ((found < 0) == in_hole).all()


def test_a_leaf_is_found_and_is_that_of_the_tree():
    terrain = Terrain(rough(17, 65), 1)
    update = terrain.update(Criterion(error_px=2.0, meshlet=2), [VIEW])
    places = np.random.default_rng(2).uniform((-300, -80), (300, 80), (200, 2))
    leaves = locate(terrain.tree, terrain.field.lattice, places)
    assert 0 <= leaves.min() and leaves.max() < update.leaves
    assert (terrain.triangles_at(places) // 16 == leaves).all()


def test_before_an_update_there_is_nothing_to_find():
    with pytest.raises(TerrainError, match="update it first"):
        Terrain(rough(9, 9), 1).triangles_at([[0.0, 0.0]])
