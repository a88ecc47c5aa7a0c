# SPDX-License-Identifier: GPL-3.0-or-later
"""The largest grid: 2^30 finest cells from west to east, with hills in its far corner."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.depths import depth_limit, plane_limit
from adaptive_terrain.cbt_terrain.field.finer_build import with_finer_tiles
from adaptive_terrain.cbt_terrain.field.heightfield import anchored
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.query.rays import pick
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights, project
from invariants import arrays, assert_invariants
from largest_grid import BITS, KNOWN, SIDE, SMALL, corner_terrain, hill_heights
from own_surface import bilinear

if sys.platform != "linux":
    pytest.skip("memory is surely committed by use on Linux only", allow_module_level=True)

HILLS = float(SIDE * KNOWN)  # metres from the far corner that the hills reach
HEIGHTS = np.zeros((SIDE * SMALL + 1, SIDE * SMALL + 1))  # of the last 2^12 x 2^12 finer cells
IN_HILLS = np.arange(SIDE * (SMALL - KNOWN), SIDE * SMALL + 1)  # beyond the hills all is level
HEIGHTS[IN_HILLS[0] :, IN_HILLS[0] :] = hill_heights(IN_HILLS, IN_HILLS[:, None])


@pytest.fixture(
    scope="module",
    params=[pytest.param((1 << 22, 1 << 18), marks=pytest.mark.thorough), ((1 << 22) - 5, (1 << 18) - 3)],
    ids=["whole", "padded"],
)
def plain(request):
    """Return the terrain, without an anchor; its squares end at its border, or 5 and 3 cells of 256 m beyond it."""
    return corner_terrain(*request.param)


@pytest.fixture(scope="module")
def field(plain):
    """Return the terrain about an anchor near its far corner."""
    east, north = plain.lattice.rectangle()[2:]
    return anchored(plain, *plain.lattice.anchor_near(east - HILLS, north - HILLS))


def expected_at(field, places):
    """Return the heights of the bilinear surface at points of the far corner, by numpy."""
    east, north = field.lattice.rectangle()[2:]
    return bilinear(HEIGHTS, *((np.asarray(places, np.float64) - (east, north)).T + SIDE * SMALL))


def places_in_corner(field, count, seed, reach=1.2 * HILLS):
    """Return points near the far corner: samples of 1 m, points between them, and some on the border."""
    rng, corner = np.random.default_rng(seed), np.array(field.lattice.rectangle()[2:])
    away = rng.random((count, 2)) * reach
    away[: count // 3] = np.rint(away[: count // 3])
    away[: count // 20, 0] = away[count // 20 : count // 10, 1] = 0.0
    return corner - away


def corner_heights(surface, field, places):
    """Return the heights of the mesh at points of the far corner; the other triangles are left out, to save time."""
    middles = surface.positions[surface.triangles].astype(np.float64).mean(axis=1)[:, :2]
    near = (np.abs(middles - field.lattice.rectangle()[2:]) < 2 * HILLS).all(axis=1)
    corner_verts = np.ascontiguousarray(surface.triangles[near]).reshape(-1)
    return mesh_heights(replace(surface, corner_verts=corner_verts), places)


def look(field, away, z, target_away, target_z):
    corner = np.array(field.lattice.rectangle()[2:])
    eye, target = corner - away, corner - target_away
    return View.look((*eye, z), (*target, target_z), resolution=(960, 540), clip=(0.1, 1e10))


@pytest.mark.thorough
def test_finest_cells_at_the_far_corner_are_reached(field):
    lattice = field.lattice
    assert lattice.span[0] << BITS == 1 << 30 and lattice.side_bits + lattice.levels + BITS == 30
    finest = lattice.cell_depth + 2 * BITS
    assert depth_limit(field) == finest == 53 > plane_limit(lattice)
    places = places_in_corner(field, 10_000, 1)
    truth = np.c_[places, expected_at(field, places)]
    views = (
        look(field, (500.0, 900.0), 240.0, (300.0, 200.0), 60.0),
        look(field, (700.0, 20.0), 260.0, (0.0, 0.0), 90.0),
        look(field, (-300.0, 200.0), 420.0, (300.0, 400.0), 0.0),
    )
    levels, bounds, worst = [], [], []
    for view in views:
        update = Terrain(field, 2).update(Criterion(error_px=1.0), [view])
        assert_invariants(update.surface, lattice)
        below = np.c_[places, corner_heights(update.surface, field, places)]
        (a, seen), (b, _) = project(view, truth), project(view, below)
        assert seen.sum() > 500 and update.triangles > 10_000
        levels.append(int(update.surface.level.max()))
        bounds.append(update.bound_px)
        worst.append(np.linalg.norm(a - b, axis=1)[seen].max())
        assert worst[-1] <= update.bound_px and (update.bound_px <= 1.0 or update.limited == "max_depth")
    # The views from 240 and 260 m reach the finest cells; there the bound counts float32 positions far from the anchor.
    assert levels[0] == levels[1] == finest and bounds[2] <= 1.0 and max(bounds) < 10.0
    assert 0.3 < max(worst) <= 1.0


def test_finest_vertices_are_those_of_the_hills(field):
    """Every sample of 1 m is a vertex of a mesh of short edges, with its height."""
    view = look(field, (60.0, 60.0), 200.0, (60.0, 60.001), 0.0)
    update = Terrain(field, 2).update(Criterion(error_px=0.0, edge_px=2.0, max_triangles=500_000), [view])
    assert_invariants(update.surface, field.lattice)
    away = np.array(field.lattice.rectangle()[2:]) - update.surface.positions[:, :2].astype(np.float64)
    near = (np.abs(away - 60.0) < 20.0).all(axis=1)
    assert np.array_equal(away[near], np.rint(away[near])) and near.sum() == 39 * 39
    found = update.surface.positions[near, 2]
    assert np.array_equal(found, expected_at(field, update.surface.positions[near, :2]).astype(np.float32))


@pytest.mark.thorough
def test_bound_in_metres_holds_at_the_far_corner(field):
    """Without a view all is refined, but nothing is steep far from the anchor."""
    update = Terrain(field, 2).update(Criterion(error_px=0.0, error_m=0.25))
    assert_invariants(update.surface, field.lattice)
    places = places_in_corner(field, 10_000, 2)
    off = np.abs(corner_heights(update.surface, field, places) - expected_at(field, places))
    assert 0.1 < off.max() <= update.bound_m <= 0.25 * (1 + 1e-6)


@pytest.mark.thorough
def test_without_an_anchor_leaves_end_where_float32_does(plain):
    """Positions are whole multiples of 32 or 64 m there: the mesh has no triangle without area, and says its error."""
    meshlet = int(plain.lattice.is_padded)
    view = look(plain, (500.0, 900.0), 240.0, (300.0, 200.0), 60.0)
    plain.cache.expanded["bilinear", 1] = plain.error  # zeros, which are the same for meshlets
    terrain = Terrain(plain, 2)
    update = terrain.update(Criterion(error_px=1.0, meshlet=meshlet), [view])
    assert_invariants(update.surface, plain.lattice, meshlet)
    assert plain.lattice.cell_depth < update.surface.level.max() < depth_limit(plain)
    assert update.limited == "max_depth" and update.bound_px > 10.0
    places = places_in_corner(plain, 5000, 3)
    truth, below = (np.c_[places, z] for z in (expected_at(plain, places), mesh_heights(update.surface, places)))
    (a, seen), (b, _) = project(view, truth), project(view, below)
    assert np.linalg.norm(a - b, axis=1)[seen].max() <= update.bound_px
    before = arrays(update.surface)
    terrain.update(Criterion(error_px=1.0, meshlet=meshlet), [look(plain, (900.0, 500.0), 240.0, (0.0, 0.0), 60.0)])
    again = terrain.update(Criterion(error_px=1.0, meshlet=meshlet), [view])
    assert arrays(again.surface) == before and arrays(Terrain(plain, 1).update(
        Criterion(error_px=1.0, meshlet=meshlet), [view]
    ).surface) == before  # fmt: skip


def test_saved_trees_of_the_largest_grid_are_restored(field):
    view = look(field, (500.0, 900.0), 240.0, (300.0, 200.0), 60.0)
    terrain = Terrain(field, 1)
    update = terrain.update(Criterion(error_px=1.0), [view])
    tree, options = terrain.saved()
    restored = Terrain(field, 2).restore(tree, **options)
    assert arrays(restored.surface) == arrays(update.surface)
    middles = update.surface.positions[update.surface.triangles].astype(np.float64).mean(axis=1)[:, :2]
    near = (np.abs(middles - np.array(field.lattice.rectangle()[2:])) < HILLS).all(axis=1)
    inside = np.flatnonzero(near)[::7]
    assert np.array_equal(terrain.triangles_at(middles[inside]), inside) and len(inside) > 1000


def test_heights_and_rays_at_the_far_corner(field):
    places = places_in_corner(field, 20_000, 4)
    ground = ground_at(field, places)
    assert ground.inside.all() and np.abs(ground.heights - expected_at(field, places)).max() < 1e-5
    rng = np.random.default_rng(5)
    origins = np.c_[places, expected_at(field, places) + rng.uniform(1, 300, len(places))][:2000]
    targets = np.c_[places[::-1], expected_at(field, places[::-1]) - 1.0][:2000]
    ways = targets - origins
    hits = pick(field, origins, ways)
    assert np.isfinite(hits.distance).all()
    assert np.abs(hits.points[:, 2] - expected_at(field, hits.points[:, :2])).max() < 1e-4
    for fraction in np.linspace(0.0, 1.0, 200, endpoint=False):  # it is the first hit: the ray is above before
        on_way = origins + fraction * (hits.points - origins)
        assert (on_way[:, 2] > expected_at(field, on_way[:, :2]) - 1e-4).all()
    corner = np.array(field.lattice.rectangle()[2:])  # a ray from 100 km away
    across = pick(field, [[*(corner - (1e5, 8e4)), 50.0]], [[1e5 - 300.0, 8e4 - 300.0, 0.0]])
    at = across.points[0, :2]
    assert np.isfinite(across.distance[0]) and abs(expected_at(field, at[None])[0] - 50.0) < 0.01


def test_a_grid_with_more_finest_cells_is_refused(field):
    """One side has 2^30 finest cells, so tiles that are finer by one step have no coordinates."""
    lattice = replace(field.lattice, anchor_x=0.0, anchor_y=0.0)
    finer = fit(2 * lattice.cells_x + 1, lattice.height, 256.0, 256.0)
    large = replace(field, raster=replace(field.raster, lattice=finer, finer=None))
    with pytest.raises(TerrainError, match="The finer tiles have 8 bits; expected 1 to 7"):
        with_finer_tiles(large, BITS, [], None)
