# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that end at the rim of a raster and at its holes: exactly there, welded, and the bound holds up to it."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from cut_surfaces import areas, assert_welded
from invariants import arrays
from own_surface import distances


def raster(width: int, height: int, missing: int = 0) -> np.ndarray:
    """Return rough ground whose missing samples form a block, touch the border and are scattered."""
    y, x = np.mgrid[:height, :width]
    random = np.random.default_rng(width)
    heights = 90.0 * np.sin(x / 17.0) * np.cos(y / 13.0) + 2.0 * random.standard_normal((height, width))
    if missing:
        heights[height // 3 : height // 2, width // 4 : width // 2] = heights[0, width // 2] = heights[-1, -1] = np.nan
        heights[random.integers(height, size=missing), random.integers(width, size=missing)] = np.nan
    return heights.astype(np.float32)


SIZES = (64, 64), (7, 200), (97, 50), (130, 33), (65, 33)
MESHES = (1e9, 0), (8.0, 0), (8.0, 2), (0.8, 1)


@pytest.mark.parametrize(
    ("size", "error_m", "meshlet"),
    [
        pytest.param(size, *mesh, marks=[] if (i + j) % 2 else pytest.mark.thorough)
        for i, size in enumerate(SIZES)
        for j, mesh in enumerate(MESHES)
    ],
)
def test_the_mesh_ends_exactly_on_the_border(size, error_m, meshlet):
    field = from_array(raster(*size), 8.0, 4.0)
    criterion = Criterion(error_px=0.0, error_m=error_m, meshlet=meshlet)
    surface = Terrain(field, 1).update(criterion).surface
    place = surface.positions[assert_welded(surface)][:, :, :2]
    west, south, east, north = field.lattice.rectangle()
    assert ((place == (west, south)) | (place == (east, north))).all(axis=1).any(axis=1).all()
    assert areas(surface).sum() == (east - west) * (north - south)
    assert len(surface.positions) - len(surface.edges) + len(surface.level) == 1
    for x, u in ((west, 0), (east, 1)):
        assert (surface.uv[surface.positions[:, 0] == x, 0] == u).sum() >= 2
    for y, v in ((south, 0), (north, 1)):
        assert (surface.uv[surface.positions[:, 1] == y, 1] == v).sum() >= 2
    assert surface.uv.min() == 0 and surface.uv.max() == 1
    assert arrays(Terrain(field, 3).update(criterion).surface) == arrays(surface)


@pytest.mark.parametrize(
    ("missing", "meshlet"),
    [(0, 2), (25, 0), *(pytest.param(*case, marks=pytest.mark.thorough) for case in ((0, 0), (25, 2)))],
)
def test_a_flight_gives_the_meshes_of_terrains_without_history(missing, meshlet):
    """Parts that are cut off one frame's arrays are restored for the next frame, which copies the common vertices."""
    field = from_array(raster(300, 150, missing), 10.0, holes=True)
    criterion, with_history = Criterion(error_px=1.0, meshlet=meshlet), Terrain(field, 2)
    for x in np.linspace(900.0, 1140.0, 4):
        view = View.look((x, 300.0, 150.0), (x + 300.0, 900.0, 0.0), resolution=(320, 240))
        assert arrays(with_history.update(criterion, [view]).surface) == arrays(
            Terrain(field, 1).update(criterion, [view]).surface
        )


@pytest.mark.parametrize("limit", [0, 2, 60, 500, 2000])
def test_a_triangle_limit_counts_triangles_of_the_cut_border(limit):
    field = from_array(raster(64, 64, 20), 10.0, holes=True)
    update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=0.1, max_triangles=limit))
    assert update.triangles <= max(limit, 4) and update.limited == "max_triangles"
    assert update.leaves > 0.4 * limit


@pytest.mark.parametrize(
    ("size", "meshlet"),
    [
        ((97, 50), 0),
        ((65, 65), 1),
        *(pytest.param((40, 200), meshlet, marks=pytest.mark.thorough) for meshlet in (0, 1)),
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in (((97, 50), 1), ((65, 65), 0))),
    ],
)
def test_holes_are_cells_of_missing_samples_and_the_bound_holds(size, meshlet):
    heights = raster(*size, missing=25)
    field = from_array(heights, 10.0, holes=True)
    missing = np.isnan(heights)
    hole = missing[1:, 1:] | missing[:-1, 1:] | missing[1:, :-1] | missing[:-1, :-1]
    for error_m in (5.0, 0.5):
        update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=error_m, meshlet=meshlet))
        surface = update.surface
        border = assert_welded(surface)
        assert areas(surface).sum() == 100.0 * (~hole).sum()
        # The border runs along the sides of cells.
        cells = surface.positions[border][:, :, :2] / np.float32(10.0) + (np.array(size, np.float32) - 1) / 2
        assert ((cells == np.rint(cells)).all(axis=1) & (cells[:, 0] == cells[:, 1])).any(axis=1).all()
        far = distances(np.where(missing, 0.0, heights), 10.0, 10.0, surface.positions, surface.corner_verts)
        middles = far[2::4, 2::4]
        assert np.array_equal(np.isnan(middles), hole) and np.nanmax(middles) <= error_m
        far = far[np.kron(~hole, np.ones((4, 4), bool)).nonzero()]
        assert not np.isnan(far).any() and 0.5 * error_m < far.max() <= error_m


def test_a_fit_ends_where_the_mesh_of_an_update_does():
    field = from_array(raster(97, 50, missing=0), 8.0)
    fitted = fit(field, 3.0)
    plain = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=3.0))
    assert_welded(fitted.surface)
    assert areas(fitted.surface).sum() == areas(plain.surface).sum()
    assert fitted.worst_m <= fitted.bound_m <= 3.0
    assert fitted.rounds > 0 and len(fitted.surface.level) < plain.triangles


def test_the_error_of_a_mesh_with_holes_is_within_its_bound():
    field = from_array(raster(97, 50, missing=25), 10.0, holes=True)
    view = View.look((-300.0, -500.0, 300.0), (0.0, 0.0, 0.0), resolution=(160, 120))
    update = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=2.0))
    measured = measure(field, update.surface, view, random_points=20_000)
    assert 1.0 < measured.vertical_max_m <= update.bound_m
