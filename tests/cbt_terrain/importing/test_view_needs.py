# SPDX-License-Identifier: GPL-3.0-or-later
"""Which tiles of a quick import views need."""

import math
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import sizing
from adaptive_terrain.cbt_terrain.attributes.tiling import Tiling
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing import refining, view_needs
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.view.view import View
from loaded_stores import QUICK, loaded_store, make_small_tiles, rough
from rasterio.transform import from_origin
from rasters import write_raster


@pytest.fixture
def small_tiles(monkeypatch):
    make_small_tiles(monkeypatch)


def camera_at(x, y, z):
    """Return the view of a camera that looks down from a point of the world."""
    to_camera = np.eye(4)
    to_camera[:3, 3] = -x, -y, -z
    zoom = np.diag([2.0, 2.0, -1.0, 0.0])
    zoom[3, 2] = -1.0
    return View(to_camera, zoom, (640, 640), clip=(0.1, 1e6))


def test_views_need_the_tiles_below_them(tmp_path, small_tiles):
    source = str(write_raster(tmp_path / "a.tif", rough(505, 401), transform=from_origin(0, 0, 10, 10)))
    run_import(ImportSettings(source, quick=QUICK), tmp_path / "store")
    field = open_store(tmp_path / "store")
    west, south, _, _ = field.lattice.rectangle()
    high = field.max_height + 100.0
    above = camera_at(west + 700.0, south + 2000.0, high)
    columns = -(-4 * field.lattice.cells_x // 64)

    def seen(*views, **more):
        return view_needs.seen_tiles(field, view_needs.SeenLand(views, np.eye(4), **more))

    below = seen(above)
    assert columns in below and len(below) <= 4, "the view is some 100 m wide"
    assert seen(camera_at(0.0, 0.0, 1e6)) == (), "no error is as large as a pixel"
    every = seen(camera_at(0.0, 0.0, 6000.0))
    assert len(every) == columns * -(-4 * field.lattice.cells_y // 64)
    assert seen(camera_at(0.0, 0.0, 6000.0), error_px=1e9) == () and seen() == ()
    wanted = view_needs.SeenLand([above], np.eye(4))
    assert view_needs.seen_tiles(field, wanted, frozenset(below[:1])) == below[1:], "loaded ones are left out"


@pytest.fixture
def field(tmp_path, small_tiles, monkeypatch):
    """Return a first picture of a slope of 2,400 m. Its squares are looked at as a whole and in cells of 4 samples."""
    heights = rough(505, 401) + np.linspace(0.0, 2400.0, 505, dtype=np.float32)
    source = str(write_raster(tmp_path / "a.tif", heights, transform=from_origin(0, 0, 10, 10)))
    run_import(ImportSettings(source, quick=QUICK), tmp_path / "store")
    monkeypatch.setattr(view_needs, "PARTS", 1)
    monkeypatch.setattr(view_needs, "NEAR_BITS", 2)
    return open_store(tmp_path / "store")


def ground_at(field, x, y):
    """Return the height of the sample that is nearest to a point."""
    west, south, _, _ = field.lattice.rectangle()
    row, column = round((y - south) / field.lattice.step_y), round((x - west) / field.lattice.step_x)
    return float(field.heights(slice(None), slice(None))[row, column])


def needs_from(field, views, placement):
    [needs] = view_needs.errors_in_view(field, 16, [view_needs.SeenLand(views, placement)])
    return needs


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_needs_near_an_eye_are_by_the_distance_of_the_ground(field, monkeypatch, scale):
    """Needs are at most those of whole squares, and at least those of boxes half as large as the cells."""
    rng, lattice = np.random.default_rng(3), field.lattice
    west, south, east, north = lattice.rectangle()
    counts = -(-lattice.cells_x // 2), -(-lattice.cells_y // 2)
    boxes = sizing.boxes(Tiling(*counts, west, south, 2 * lattice.step_x, 2 * lattice.step_y, 0.0), field, 1.0, 0.0)
    errors = field.table[0][view_needs._centre_codes(field)].ravel()
    lower, placement = 0, np.diag([scale, scale, scale, 1.0])
    for _ in range(40):
        x, y = rng.uniform((west, south), (east, north))
        view = camera_at(x * scale, y * scale, scale * (ground_at(field, x, y) + rng.uniform(-50.0, 700.0)))
        needs = needs_from(field, [view], placement)
        with monkeypatch.context() as patch:
            patch.setattr(view_needs, "NEAR_BITS", 30)
            whole = needs_from(field, [view], placement)
        pixels = sizing.footprints(boxes, [view], placement, only_seen=True, nearest=10.0)
        found = np.zeros_like(needs)
        rows, columns = np.divmod(np.arange(len(boxes)), counts[0])
        np.maximum.at(found, (rows // 8, columns // 8), np.nan_to_num(errors / pixels))
        assert np.isfinite(whole).all() and (needs <= whole).all() and (needs >= found * (1 - 1e-9)).all()
        lower += int((needs < 0.5 * whole).sum())
    assert lower > 30, "the box of a square encloses much air"


@pytest.mark.parametrize("scale", [(1.0, 1.0, 5.0), (1.0, 1.0, -5.0), (4.0, 4.0, 1.0), (4.0, 2.0, 0.5)])
def test_an_objects_scale_counts_for_errors_in_height(field, scale):
    """A vertical scale on the object and the same one in the settings have the same needs."""
    x, y, z = scale
    across = np.diag([x, y, max(x, y), 1.0])
    view = camera_at(0.0, 0.0, 3e5)  # distances hardly differ
    scaled = view_needs.SeenLand([view], np.diag([*scale, 1.0]))
    wanted = view_needs.SeenLand([view], across, vertical_scale=z / max(x, y))
    [needs, same] = view_needs.errors_in_view(field, 16, [scaled, wanted])
    assert needs.max() > 0.0 and np.allclose(needs, same, rtol=1e-6)


@pytest.mark.parametrize("wrong", [{"vertical_scale": math.nan}, {"vertical_offset": math.nan}])
def test_heights_that_are_no_numbers_are_refused(field, wrong):
    """A driver or a script may set NaN. It has no errors in view, which would count as fine enough."""
    seen = view_needs.SeenLand([camera_at(0.0, 0.0, 6000.0)], np.eye(4), **wrong)
    with pytest.raises(TerrainError, match="The vertical scale .* and offset .* give heights that no mesh can hold"):
        view_needs.seen_tiles(field, seen)


def test_an_eye_in_a_square_has_the_need_of_the_finest_step(field):
    """The need there is that at a distance of 10 m, the step of all samples."""
    west, south, east, north = field.lattice.rectangle()
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    view = camera_at(x, y, ground_at(field, x, y) + 0.01)
    needs, largest = needs_from(field, [view], np.eye(4)), view_needs._centre_codes(field)
    per_pixel = 10.0 / view.pixels_per_unit
    assert 0.0 < needs.max() <= field.table[0][largest.max()] / per_pixel * (1 + 1e-9)
    assert needs.max() > 0.1 * field.table[0][largest.max()] / per_pixel


def test_an_eye_high_above_a_slope_needs_few_tiles(field):
    """It is 600 m above the ground, and in the box of a square that is 1,280 m long and rises by 600 m and more."""
    west, south, east, north = field.lattice.rectangle()
    x, y = west + 0.4 * (east - west), 0.5 * (south + north)
    seen = view_needs.SeenLand([camera_at(x, y, ground_at(field, x, y) + 600.0)], np.eye(4))
    highest = max(needs.max() for needs in view_needs.errors_in_view(field, 16, [seen]))
    exact = view_needs._centre_codes(field).max()
    assert highest <= field.table[0][exact] / (300.0 / seen.views[0].pixels_per_unit), (
        "the ground is 300 m away or more"
    )


def test_tiles_with_all_samples_need_no_complete_import(tmp_path, small_tiles):
    """A step of four samples is that of the tiles: a camera on the ground then needs its tiles only."""
    source = str(write_raster(tmp_path / "a.tif", rough(505, 401), transform=from_origin(0, 0, 10, 10)))
    settings, store = ImportSettings(source, quick=13_000), tmp_path / "store"
    run_import(settings, store)
    picture = open_store(store)
    assert refining.are_all_samples(picture)
    land = view_needs.SeenLand([camera_at(0.0, 0.0, ground_at(picture, 0.0, 0.0) + 2.0)], np.eye(4))
    wanted = view_needs.missing_tiles(store, land)
    assert 0 < len(wanted) < refining.picture_tiles(picture) / 4
    assert not view_needs.is_fine_enough(store, [land])
    run_import(replace(settings, loaded_tiles=wanted), store)
    assert view_needs.is_fine_enough(store, [land]) and view_needs.are_loaded_enough(store, [land])
    assert view_needs.needed_tiles(store, [land]) == set(wanted)


def test_views_that_tiles_satisfy_need_no_more(tmp_path, small_tiles, monkeypatch):
    settings, store = loaded_store(tmp_path, rough(505, 401), from_origin(5e5, 5e6, 10.0, 10.0), (0,))
    west, south, _, _ = open_store(store).lattice.rectangle()
    near = view_needs.SeenLand([camera_at(west + 700.0, south + 2000.0, 1500.0)], np.eye(4))
    far = near._replace(error_px=1e4)
    assert not view_needs.is_fine_enough(store, [near]) and view_needs.is_fine_enough(store, [far])
    assert not view_needs.is_fine_enough(store, [far, near]), "one of them needs more"
    assert not view_needs.missing_tiles(store, far), "none is missing there"
    wanted = view_needs.missing_tiles(store, near)
    assert wanted and 0 not in wanted
    assert view_needs.all_missing_tiles(store, [far, near]) == wanted
    run_import(settings, tmp_path / "first")
    assert view_needs.is_fine_enough(tmp_path / "first", [far]), "a large source is not imported for a distant view"
    assert not view_needs.is_fine_enough(tmp_path / "first", [far, near])
    monkeypatch.setattr(refining, "FEWEST", 1 << 29)
    assert not view_needs.is_fine_enough(tmp_path / "first", [far]), "all of a smaller one are soon there"
