# SPDX-License-Identifier: GPL-3.0-or-later
"""Places and views of terrains with finer tiles, in which bounds must hold."""

from dataclasses import replace

import numpy as np
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField, anchored
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights, random_view, reference_heights, screen_error
from invariants import assert_invariants

VIEWS = 8


def places_on(field: HeightField, count: int, seed: int) -> np.ndarray:
    """Return points of the plan, metres: half in or near tiles, some at finer samples and on the borders of tiles."""
    rng, tiles = np.random.default_rng(seed), field.raster.finer
    low, high = np.split(np.array(field.lattice.rectangle()), 2)
    side = SIDE * field.lattice.step_x / (1 << tiles.bits)
    rows, columns = np.nonzero(tiles.numbers >= 0)
    some = rng.integers(len(rows), size=count)
    part = rng.random((count, 2))
    part[::5, 0] = np.round(part[::5, 0])
    near = low + (np.stack([columns[some], rows[some]], 1) + part) * side
    near[::3] = low + np.round((near[::3] - low) * (SIDE / side)) * (side / SIDE)
    found = np.concatenate([low + rng.random((count, 2)) * (high - low), near])
    return found[((found >= low) & (found <= high)).all(axis=1)]


def assert_bound_in_metres(field: HeightField, reference: HeightField, places: np.ndarray, errors) -> None:
    """Assert that meshes of these errors, metres, are as near to the true heights as they say, and no nearer."""
    for error_m in errors:
        update = Terrain(field).update(Criterion(error_px=0.0, error_m=error_m))
        off = np.abs(mesh_heights(update.surface, places) - reference_heights(reference, places))
        assert off.max() <= update.bound_m and update.bound_m <= error_m * (1 + 1e-6)
        assert off.max() > 0.2 * error_m
        if field.valid is None:
            assert_invariants(update.surface, field.lattice)


def assert_no_cracks(field: HeightField, at: np.ndarray) -> None:
    """Assert the invariants of meshes by lengths of edges and areas, seen from above a place."""
    view = View.look((*at, 160.0), (*(at + 400), 60.0), resolution=(960, 540))
    for setting in ({"edge_px": 12.0}, {"area_px": 90.0}, {"edge_px": 5.0, "error_px": 2.0}):
        update = Terrain(field).update(Criterion(**{"error_px": 0.0} | setting, max_triangles=500_000), [view])
        assert_invariants(update.surface, field.lattice)


def assert_bounds_in_random_views(
    field: HeightField, reference: HeightField, places: np.ndarray, seed: int, meshlet: int
) -> int:
    """Assert that bounds hold in random views, every other one near a place; return the finest level of all meshes.

    reference: field whose heights at the places are the true ones. places: points of the plan, metres.
    """
    rng, finest = np.random.default_rng(seed), 0
    for number in range(VIEWS):
        view = random_view(rng, field)
        if number % 2:
            at = places[rng.integers(len(places))]
            z = float(reference_heights(reference, at[None])[0])
            view = View.look((*at, z + 10 ** rng.uniform(0.3, 2.5)), (*(at + rng.normal(size=2) * 300), z))
        criterion = Criterion(error_px=float(10 ** rng.uniform(-0.5, 1)), meshlet=meshlet, max_triangles=60_000)
        update = Terrain(field).update(criterion, [view])
        assert_invariants(update.surface, field.lattice, meshlet)
        assert screen_error(view, reference, update.surface, places) <= update.bound_px * (1 + 1e-6) + 1e-4
        finest = max(finest, int(update.surface.level.max()))
    return finest


def assert_an_anchor_moves_the_surface_alone(field: HeightField, places: np.ndarray) -> None:
    """Assert that heights at places of the plan, metres, do not depend on the anchor of a georeferenced field."""
    raster = replace(field.raster, origin=np.array([5e5, 5e6, 0.0]), place=(1.0, 0.0, 5e5, 0.0, 1.0, 5e6))
    moved = anchored(replace(field, raster=raster), 1024.0, -1024.0)
    found, expected = ground_at(moved, places - [1024.0, -1024.0]), ground_at(field, places)
    assert np.allclose(found.heights, expected.heights, atol=1e-9, equal_nan=True)
