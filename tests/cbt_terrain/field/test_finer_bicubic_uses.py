# SPDX-License-Identifier: GPL-3.0-or-later
"""Uses of the bicubic surface with finer tiles: holes, hidden ground, scatter, exports, and removal of its files."""

import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.finer_pyramid import finer_heights
from adaptive_terrain.cbt_terrain.exporting.height_tiles import HeightTiles, export_height_tiles
from adaptive_terrain.cbt_terrain.field import derived_arrays, store_folder
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import extent, mesh_heights, reference_heights, rough
from finer_fields import finer_field, finer_store, in_small_squares, relief_reader
from first_hits import as_keys, first_hits

HOLE = np.s_[36:44, 38:47]  # rows and columns of samples, in the known tile and across a border of it
MIDDLE = np.array([256.0, 256.0])  # of the known tile, metres from the raster's middle


@pytest.fixture(scope="module")
def holed(tmp_path_factory):
    """Return the bicubic surface of 65 x 65 samples of 32 m with a tile of 2 m, and a hole in it; from a store."""
    store = finer_store(tmp_path_factory.mktemp("holed") / "store", 65, 65, 4, [(2, 2)], hole=HOLE)
    return interpolated(open_store(store), "bicubic")


@pytest.fixture(scope="module")
def field():
    return interpolated(finer_field(65, 65, 4, ((2, 2),)), "bicubic")


def places_near(field, count, seed, reach=300.0):
    """Return points of the terrain, half of them within `reach` metres of the known tile's middle along each axis."""
    rng = np.random.default_rng(seed)
    low, size = np.array(field.lattice.rectangle()[:2]), extent(field)[:2]
    return np.concatenate([low + rng.random((count, 2)) * size, MIDDLE + rng.uniform(-reach, reach, (count, 2))])


def in_hole(field, places):
    """Return whether points are in raster cells with a missing corner."""
    i, j = ((places - field.lattice.rectangle()[:2]) / 32.0).astype(int).T
    lost = field.valid == 0
    return lost[j, i] | lost[j, i + 1] | lost[j + 1, i] | lost[j + 1, i + 1]


def test_a_hole_in_a_tile_is_cut_out_and_bounds_hold_beside_it(holed):
    places = places_near(holed, 10_000, 1)
    missing, ground = in_hole(holed, places), ground_at(holed, places)
    assert 500 < missing.sum() < len(places) / 2 and np.array_equal(~ground.inside, missing)
    assert np.isnan(ground.heights[missing]).all()
    truth = reference_heights(holed, places[~missing])
    assert np.abs(ground.heights[~missing] - truth).max() < 3e-5
    for error_m in (4.0, 1.0):
        terrain = Terrain(holed)
        update = terrain.update(Criterion(error_px=0.0, error_m=error_m))
        assert np.array_equal(terrain.triangles_at(places) < 0, missing)
        off = np.abs(mesh_heights(update.surface, places[~missing]) - truth)
        assert 0.2 * error_m < off.max() <= update.bound_m <= error_m * (1 + 1e-6)


def test_hidden_ground_is_coarser_and_seen_ground_is_not():
    """A ridge of 300 m hides a part of the known tile."""
    heights = rough(65, 65, 7, relief=80.0).heights().copy()
    heights[:, 36:38] += 300.0
    plain = from_array(heights, 32.0)
    field = interpolated(in_small_squares(plain, 4, [(2, 2)], relief_reader(plain, 4)), "bicubic")
    x, y = -100.0, 250.0  # before the ridge, in the ring of tiles
    z = float(ground_at(field, np.array([[x, y]])).heights[0]) + 60.0
    view = View.look((x, y, z), (900.0, y, z), resolution=(640, 360), clip=(0.5, 1e5))
    whole = Terrain(field).update(Criterion(error_px=2.0), [view])
    culled = Terrain(field).update(Criterion(error_px=2.0, hidden_factor=50.0), [view])
    seen = as_keys(culled.surface, first_hits(culled.surface, view, np.eye(4)))
    assert seen <= as_keys(whole.surface, np.arange(whole.triangles)) and len(seen) > 100
    assert culled.triangles < 0.6 * whole.triangles


def test_scattered_points_are_on_the_surface(field):
    points = scatter_points(field, Scatter(spacing=9.0))
    places = points.positions[:, :2].astype(np.float64)
    assert np.abs(points.positions[:, 2] - reference_heights(field, places)).max() < 1e-3
    ground = ground_at(field, places)
    assert np.abs(points.normals - ground.normals).max() < 1e-3
    assert (np.abs(places - MIDDLE).max(axis=1) < 250.0).sum() > 1000


def test_exported_tiles_have_the_heights_of_the_surface(holed, tmp_path):
    export_height_tiles(holed, tmp_path, HeightTiles("r32", step=2.0))
    found = np.fromfile(tmp_path / "terrain_x0_y0.r32", "<f4").reshape(1025, 1025)[::-1]
    y, x = np.mgrid[0:1025:3, 0:1025:3]
    places = np.stack([x.ravel(), y.ravel()], 1) * 2.0 - 1024.0
    cell = np.minimum(np.stack([x.ravel(), y.ravel()], 1) / 16.0, 63.5)
    sides = [in_hole(holed, (cell - part) * 32.0 - 1024.0) for part in (0.0, (1e-6, 0.0), (0.0, 1e-6), (1e-6, 1e-6))]
    is_ground = ~np.logical_and.reduce(sides)
    off = found[::3, ::3].ravel() - reference_heights(holed, places)
    assert np.abs(off[is_ground]).max() < 1e-4


def test_the_files_of_the_surface_go_with_their_store(holed, tmp_path, monkeypatch):
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 1)
    shutil.copytree(holed.path, tmp_path / "copy")
    copy = interpolated(open_store(tmp_path / "copy"), "bicubic")
    finer_heights(copy.raster, 1)
    folder = store_folder.named_folder(tmp_path / "copy")
    names = {file.name for file in folder.iterdir()}
    assert {"finer_heights_c.npy", "finer_values_c.npy", "finer_pyramid.npy"} <= names
    store_folder.remove_store(tmp_path / "copy")
    assert not (tmp_path / "copy").exists()
