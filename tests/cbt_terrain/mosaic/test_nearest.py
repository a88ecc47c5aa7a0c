# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick imports of several files: samples of the full mosaic for files on its grid, the nearest ones for others."""

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.importing import thinning
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.mosaic import composite as composites
from adaptive_terrain.cbt_terrain.mosaic import nearest
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from mosaic_files import DEGREES, EAST, NORTH, UTM32, land, moved, settings_of, sheet
from rasterio.enums import Resampling
from rasterio.transform import from_origin
from rasters import write_raster

ROWS, COLUMNS = np.array([0, 1, 7, 40, 41, 99, 119]), np.array([0, 3, 50, 51, 52, 100, 159])


@pytest.fixture
def tiles(tmp_path):
    """Write an area of 160 x 120 samples as tiles with a gap, an overlap and missing samples."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 160, 120)
    whole.heights[20:50, 30:60] = np.nan
    cuts = [(0, 60, 0, 80), (0, 60, 80, 80), (60, 60, 0, 70), (60, 60, 90, 70)]
    files = [whole.write(tmp_path / f"{n}.tif", *cut) for n, cut in enumerate(cuts)]
    upper = sheet(UTM32, EAST + 300, NORTH - 300, 10.0, 10.0, 50, 50, shift=40.0)
    upper.heights[:10] = np.nan
    return [*files, upper.write(tmp_path / "upper.tif")]


@pytest.mark.parametrize("priority", ["order", "newest"])
def test_samples_on_the_grid_are_those_of_the_mosaic(tiles, priority):
    composite = open_composite(settings_of(*tiles, priority=priority), None)
    whole, _ = composite.read(0, composite.grid.height)
    assert np.array_equal(
        nearest.nearest_samples(composite, ROWS, COLUMNS), whole[np.ix_(ROWS, COLUMNS)], equal_nan=True
    )
    every = np.arange(composite.grid.height), np.arange(composite.grid.width)
    assert np.array_equal(nearest.nearest_samples(composite, *every), whole, equal_nan=True)
    assert 0.02 < np.isnan(whole).mean() < 0.2 and composite.stored == "float32"


def test_parts_of_a_tile_are_read_in_bands(tiles, monkeypatch):
    monkeypatch.setattr(nearest, "MAX_PART", 100)
    test_samples_on_the_grid_are_those_of_the_mosaic(tiles, "order")


def test_other_systems_give_the_nearest_sample(tmp_path):
    west, north = (float(v) for v in moved(UTM32, DEGREES, EAST, NORTH))
    degrees = sheet(DEGREES, west, north, 1 / 9000, 1 / 9000, 150, 100)
    files = [degrees.write(tmp_path / "a.tif"), sheet(UTM32, EAST, NORTH, 5.0, 5.0, 20, 20).write(tmp_path / "b.tif")]
    composite = open_composite(settings_of(*files), None)
    rows, columns = np.arange(0, composite.grid.height, 9), np.arange(0, composite.grid.width, 7)
    found = nearest.nearest_samples(composite, rows, columns)
    x, y = composite.grid.positions(*np.meshgrid(composite.grid.column + columns, composite.grid.row + rows))
    u, v = degrees.indices(UTM32, x, y)
    inside = (u > 0) & (u < 149) & (v > 0) & (v < 99)
    own = (x > EAST) & (x < EAST + 100) & (y < NORTH) & (y > NORTH - 100)
    p, q = np.rint(np.where(inside, u, 0)).astype(int), np.rint(np.where(inside, v, 0)).astype(int)
    other = inside & ~own
    assert other.mean() > 0.7 and np.array_equal(found[other], degrees.heights[q, p][other])
    # A sample is at most half a cell from its place on land with slopes of up to 0.6.
    assert np.abs(found - land(x, y))[inside].max() < 0.6 * 12.4 / 2 * np.sqrt(2)


def test_a_quick_mosaic_covers_the_ground_of_the_full_one(tiles, tmp_path):
    full = import_source(settings_of(*tiles), tmp_path / "full")
    quick = run_mosaic_import(settings_of(*tiles, quick=400), tmp_path / "quick")
    a, b = open_store(tmp_path / "full"), open_store(tmp_path / "quick")
    assert quick["loaded"] == "to 79.5 m of 10 m"
    assert (
        np.array_equal(a.origin, b.origin) and a.crs == b.crs and quick["extent_m"] == pytest.approx(full["extent_m"])
    )
    assert "seams" not in quick and full["seams"] > 0, "seams are of the complete import"
    assert import_source(settings_of(*tiles, quick=400), tmp_path / "full") == full | {"unchanged": True}
    again = run_mosaic_import(settings_of(*tiles), tmp_path / "quick")
    assert read_json(tmp_path / "quick")["key"] == read_json(tmp_path / "full")["key"] and "loaded" not in again


def test_each_file_is_opened_once_for_samples(tiles, tmp_path, monkeypatch):
    opened, real = [], composites.open_tile
    monkeypatch.setattr(composites, "open_tile", lambda path, settings: opened.append(path) or real(path, settings))
    run_mosaic_import(settings_of(*tiles, quick=400), tmp_path / "store")
    assert sorted(map(str, opened)) == sorted(map(str, tiles))


def test_a_mosaic_beyond_a_store_is_loaded_quickly(tmp_path):
    far = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 30, 30)
    corner = sheet(UTM32, EAST + 500_000, NORTH - 500_000, 10.0, 10.0, 30, 30)
    files = [far.write(tmp_path / "a.tif"), corner.write(tmp_path / "b.tif")]
    report = run_mosaic_import(settings_of(*files, quick=10_000), tmp_path / "store")
    assert report["full_raster"] == [50_030, 50_030] and report["loaded"] == "to 5,105 m of 10 m"
    assert open_store(tmp_path / "store").heights()[-1, 0] == np.float32(far.heights[0, 0])
    assert open_store(tmp_path / "store").heights()[0, -1] == np.float32(corner.heights[-1, -1])


def test_overviews_are_read_at_their_places(tmp_path, monkeypatch):
    """A mean over 8 x 8 samples of a plane is the plane at the place of the mean, at most half of 8 samples off."""
    rows, columns = np.mgrid[0:512, 0:512]
    plane = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 512, 512)
    plane.heights[:] = 2.0 * columns + 3.0 * rows
    files = [plane.write(tmp_path / f"{n}.tif", 0, 512, 256 * n, 256, tiled=True) for n in range(2)]
    for file in files:
        with rasterio.open(file, "r+") as opened:
            opened.build_overviews([2, 4, 8], Resampling.average)
    monkeypatch.setattr(nearest, "MAX_UNPACKED", 1)
    report = run_mosaic_import(settings_of(*files, quick=100), tmp_path / "store")
    heights = open_store(tmp_path / "store").heights()[::-1]
    assert report["loaded_from"] == "overviews" and heights.shape == (9, 9)
    at = np.rint(np.arange(9) * 511 / 8)
    exact = 2.0 * at + 3.0 * at[:, None]
    assert np.abs(heights - exact).max() <= 3.5 * 2 + 3.5 * 3 + 0.01 and np.abs(heights - exact).max() > 1.0
    # In the mean over all places, nothing is shifted: half of 8 samples would be 17.5 m.
    assert abs((heights - exact).mean()) < 3.0
    single = write_overviews(tmp_path / "single.tif", plane.heights.astype(np.float32))
    monkeypatch.setattr(thinning, "MAX_UNPACKED", 1)
    report = run_import(ImportSettings(single, quick=100), tmp_path / "one")
    assert report["loaded_from"] == "overviews"
    assert np.array_equal(open_store(tmp_path / "one").heights()[::-1], heights)


def write_overviews(path, heights):
    write_raster(path, heights, crs=UTM32, transform=from_origin(EAST, NORTH, 10, 10), tiled=True)
    with rasterio.open(path, "r+") as opened:
        opened.build_overviews([2, 4, 8], Resampling.average)
    return str(path)


AUX_NO_DATA = '<PAMDataset><PAMRasterBand band="1"><NoDataValue>7</NoDataValue></PAMRasterBand></PAMDataset>'


@pytest.mark.parametrize(
    ("kind", "mask_levels"),
    [(".msk", [2, 4, 8]), (".msk", []), (".aux.xml", []), (".ovr", []), (None, [])],
)
def test_files_beside_tiles_count_in_overviews(tmp_path, monkeypatch, kind, mask_levels):
    """A mask or a no-data value of the eastern tile, or the overviews of both, are in files beside them.

    GDAL would take all samples as valid in overviews that the mask lacks.
    """
    heights = np.full((512, 256), 7.0, np.float32)
    heights[:, :128] = 500.0
    for n in range(2):
        place = {"crs": UTM32, "transform": from_origin(EAST + 2560 * n, NORTH, 10, 10)}
        write_raster(tmp_path / f"{n}.tif", heights, tiled=True, **place)
    with rasterio.Env(TIFF_USE_OVR=kind == ".ovr", GDAL_TIFF_INTERNAL_MASK=False):
        for n in range(2):
            with rasterio.open(tmp_path / f"{n}.tif", "r+") as file:
                file.build_overviews([2, 4, 8], Resampling.nearest)
        if kind == ".msk":
            with rasterio.open(tmp_path / "1.tif", "r+") as file:
                file.write_mask(np.where(heights > 7.0, 255, 0).astype(np.uint8))
            with rasterio.open(tmp_path / "1.tif.msk", "r+") as file:
                file.build_overviews(mask_levels, Resampling.nearest)
    if kind == ".aux.xml":
        (tmp_path / "1.tif.aux.xml").write_text(AUX_NO_DATA)
    assert kind is None or (tmp_path / f"1.tif{kind}").exists()
    monkeypatch.setattr(nearest, "MAX_UNPACKED", 1)
    report = run_mosaic_import(settings_of(tmp_path / "0.tif", tmp_path / "1.tif", quick=1000), tmp_path / "store")
    assert report["loaded_from"] == "overviews"
    # The tile in the east has 7 m, or no sample, in its eastern half; the one in the west has 7 m there.
    loaded = open_store(tmp_path / "store").heights()
    rows, columns = loaded.shape
    quarter, hides = columns // 4, kind in (".msk", ".aux.xml")
    assert report["filled"] == (rows * quarter if hides else 0)
    assert (loaded[:, -quarter:] == (500.0 if hides else 7.0)).all() and (loaded[:, 2 * quarter - 1] == 7.0).all()
