# SPDX-License-Identifier: GPL-3.0-or-later
"""Random views of terrains with finer tiles, in which bounds must hold."""

from dataclasses import replace

import numpy as np
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField, anchored
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import random_view, reference_heights, screen_error
from invariants import assert_invariants

VIEWS = 8


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
