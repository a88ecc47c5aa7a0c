# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasters that do not fill their lattice: the bound over their whole surface, by independent code."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from own_surface import distances
from padded import raster


def test_what_is_beyond_the_rim_is_not_refined():
    """A raster fills a quarter of its square, so a criterion of edges refines about a quarter."""
    field = from_array(np.zeros((34, 34), np.float32), 10.0)
    view = View.look((0.0, 0.0, 5000.0), (0.0, 1.0, 0.0), resolution=(2000, 2000))
    terrain = Terrain(field, 1, whole=True)
    for edge_px in (30.0, 10.0, 4.0):
        update = terrain.update(Criterion(error_px=0.0, edge_px=edge_px), [view])
        corners = update.surface.positions[update.surface.triangles][..., :2].min(axis=1)
        beyond = (corners >= field.lattice.rectangle()[2]).any(axis=1).mean()
        assert update.triangles > 64 and beyond < 0.5
    assert beyond < 0.1, "a rim's part of fine triangles"


def test_a_bicubic_bound_holds_to_the_rim():
    heights = raster(45, 38)
    field = interpolated(from_array(heights, 10.0), "bicubic")
    assert field.lattice.is_padded
    update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=2.0))
    # On samples both surfaces are the same.
    far = distances(heights, 10.0, 10.0, update.surface.positions, update.surface.corner_verts, parts=1)
    assert 0.5 < far.max() <= 2.0


def test_a_flight_over_the_border_is_independent_of_history():
    field = from_array(raster(130, 90), 10.0)
    kept = Terrain(field, 1)
    for x in np.linspace(300.0, 900.0, 7):
        view = View.look((x, -50.0, 120.0), (x + 100.0, 200.0, 0.0), resolution=(320, 240))
        criterion = Criterion(error_px=1.0, edge_px=40.0, max_triangles=3000)
        one, other = kept.update(criterion, [view]), Terrain(field, 2).update(criterion, [view])
        assert one.surface.positions.tobytes() == other.surface.positions.tobytes()
        assert one.relaxed == other.relaxed
