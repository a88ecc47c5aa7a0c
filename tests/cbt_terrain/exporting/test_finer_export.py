# SPDX-License-Identifier: GPL-3.0-or-later
"""Exported heights of a country at 32 feet with a city at 2 and a town at 1: compared with the files by rasterio."""

import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.attributes.attribute import AttributeRequest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.exporting import height_tiles
from adaptive_terrain.cbt_terrain.exporting.height_tiles import HeightTiles, export_height_tiles
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import exported_rows
from adaptive_terrain.cbt_terrain.height_operators.export import export_raster
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.query.grid import grid_axes
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import from_origin
from rasterio.windows import from_bounds
from rasters import write_raster

FOOT = 1200 / 3937  # of EPSG:2263, metres
EAST, NORTH = 980_000.0, 200_000.0  # feet, as all lengths of the files
CITY, TOWN = (EAST + 1244.0, NORTH - 432.0), (EAST + 2044.0, NORTH - 632.0)  # corners in the north-west
BITS = 5
SIZE = 1009  # samples along a side of a tile
THOROUGH = pytest.mark.thorough


def ground(west, north, step, columns, rows, seed):
    """Return heights in feet: hills and rough ground, float32."""
    x, y = np.meshgrid(west + (np.arange(columns) + 0.5) * step, north - (np.arange(rows) + 0.5) * step)
    rough = np.random.default_rng(seed).random((rows, columns)) * 3.0
    return (900.0 + 90.0 * np.sin(x / 810.0) * np.cos(y / 670.0) + rough).astype(np.float32)


def write(path, corner, step, heights):
    """Write heights as a GeoTIFF with its place; NaN is missing."""
    place = {"crs": "EPSG:2263", "transform": from_origin(*corner, step, step), "nodata": -9999.0}
    return write_raster(path, np.where(np.isnan(heights), np.float32(-9999.0), heights), **place)


@pytest.fixture(scope="module")
def land(tmp_path_factory):
    """Return the folder of the files and of the store of them, whose heights are feet."""
    folder = tmp_path_factory.mktemp("land")
    (folder / "files").mkdir()
    country = ground(EAST, NORTH, 32.0, 100, 54, 1)
    country[20:30, 4:19] = np.nan  # nothing is known there
    city = ground(*CITY, 2.0, 800, 500, 2)
    city[60:70, 60:75] = np.nan
    town = ground(*TOWN, 1.0, 700, 600, 3)
    town[500:503, 500:620] = np.nan
    write(folder / "files" / "a.tif", (EAST, NORTH), 32.0, country)
    write(folder / "files" / "b.tif", CITY, 2.0, city)
    write(folder / "files" / "c.tif", TOWN, 1.0, town)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(finer_plan, "FEWEST", 1 << 20)
        patch.setattr(finer_plan, "SAVING", 1)  # the country is small
        settings = ImportSettings(str(folder / "files"), height_scale=FOOT, holes=True)
        report = run_mosaic_import(settings, folder / "store")
    assert report["finer_step_m"] == pytest.approx([FOOT, FOOT]) and report["finer_tiles"] > 50
    return folder


@pytest.fixture(scope="module")
def finest(land):
    """Return the path of a GeoTIFF of all heights at 1 foot."""
    [file] = export_raster(land / "store", land / "finest.tif", step=FOOT)
    return file


@pytest.fixture(scope="module")
def finest_heights(finest):
    """Return the pixels of that file, which tests do not change."""
    with rasterio.open(finest) as file:
        heights = file.read(1)
    heights.flags.writeable = False
    return heights


def metres(heights):
    """Return heights in feet as the import converts them."""
    return (heights.astype(np.float64) * FOOT).astype(np.float32)


def shared_pixels(exported, source, bounds):
    """Return the pixels of both files in a box that has a corner of both, read by rasterio."""
    with rasterio.open(exported) as found, rasterio.open(source) as wanted:
        assert found.crs == wanted.crs
        windows = [from_bounds(*bounds, file.transform).round_offsets().round_lengths() for file in (found, wanted)]
        heights = wanted.read(1, window=windows[1])
        heights[heights == -9999.0] = np.nan
        return found.read(1, window=windows[0]), heights


@pytest.mark.thorough
def test_pixels_of_the_finest_file_are_exported_bit_by_bit(land, finest):
    west, north = TOWN
    inner = west + 140, north - 340, west + 380, north - 140  # without the rings of the border and of the gap
    found, wanted = shared_pixels(finest, land / "files" / "c.tif", inner)
    assert found.shape == wanted.shape == (200, 240) and not np.isnan(wanted).any()
    assert (found == metres(wanted)).all() and np.ptp(np.diff(wanted)) > 4.0
    found, wanted = shared_pixels(finest, land / "files" / "c.tif", (west, north - 600, west + 700, north))
    assert np.isnan(wanted).sum() == 360 and not np.isnan(found).any()


def test_pixels_of_the_other_files_are_between_their_samples(land, finest):
    west, north = CITY
    inner = west + 420, north - 760, west + 620, north - 460
    found, wanted = shared_pixels(finest, land / "files" / "b.tif", inner)
    assert found.shape == (300, 200) and wanted.shape == (150, 100)
    # A pixel of 2 feet has its centre between four pixels of 1 foot, a quarter of its cell from each.
    mean = (found[::2, ::2] + found[1::2, ::2] + found[::2, 1::2] + found[1::2, 1::2])[1:-1, 1:-1] / 4
    h = wanted.astype(np.float64) * FOOT
    row = h[:-2] / 8 + h[1:-1] * 3 / 4 + h[2:] / 8
    smooth = row[:, :-2] / 8 + row[:, 1:-1] * 3 / 4 + row[:, 2:] / 8
    assert np.abs(mean - smooth).max() < 2e-4


def test_the_finest_raster_has_the_extent_of_the_coarse_one(land, finest):
    lattice = open_store(land / "store").lattice
    with rasterio.open(finest) as found, rasterio.open(land / "files" / "c.tif") as town:
        assert found.shape == ((lattice.cells_y << BITS) + 1, (lattice.cells_x << BITS) + 1)
        column, row = ~found.transform * (town.transform * (0.5, 0.5))
        assert found.transform.a == pytest.approx(1.0, rel=1e-12) and found.transform.e == pytest.approx(
            -1.0, rel=1e-12
        )
        assert (column % 1, row % 1) == pytest.approx((0.5, 0.5), abs=1e-4)


@pytest.mark.parametrize("part", [pytest.param(1, marks=THOROUGH), 4, BITS])
def test_coarser_steps_have_the_same_samples(land, finest, finest_heights, part, tmp_path):
    step = FOOT * 2**part if part < BITS else 0.0  # the default is that of the raster
    [file] = export_raster(land / "store", tmp_path / "heights.tif", step=step)
    with rasterio.open(file) as found, rasterio.open(finest) as whole:
        assert np.array_equal(found.read(1), finest_heights[:: 2**part, :: 2**part], equal_nan=True)
        centres = found.transform * (0.5, 0.5), whole.transform * (0.5, 0.5)
        assert centres[0] == pytest.approx(centres[1], abs=1e-6)


def test_holes_are_missing(land, finest, finest_heights):
    """The raster is not on the pixels of the country, so a gap of 10 x 15 pixels has up to two cells more."""
    with rasterio.open(finest) as found, rasterio.open(land / "files" / "a.tif") as country:
        missing = np.isnan(finest_heights)
        rows, columns = np.nonzero(country.read(1) == -9999.0)
        x, y = country.transform * (columns + 0.5, rows + 0.5)
        column, row = (np.rint(at - 0.5).astype(int) for at in ~found.transform * (x, y))
    assert missing[row, column].all() and len(row) == 150
    rows, columns = np.nonzero(missing)
    assert 0 < row.min() - rows.min() < 64 and 0 < rows.max() - row.max() < 64
    assert 0 < column.min() - columns.min() < 64 and 0 < columns.max() - column.max() < 64


def test_a_step_between_is_interpolated_by_other_code(land, finest_heights, tmp_path):
    """Points of a step of 0.7 feet are on the bilinear surface of the pixels of 1 foot."""
    [file] = export_raster(land / "store", tmp_path / "heights.exr", step=40 * 0.7 * FOOT)
    import OpenEXR

    found = OpenEXR.File(str(file), separate_channels=True).parts[0].channels["Y"].pixels
    heights = finest_heights.astype(np.float64)
    rows, columns = (np.arange(count) * 28.0 for count in found.shape)
    assert len(rows) == (len(heights) - 1) // 28 + 1
    assert np.array_equal(
        found, heights[np.ix_(rows.astype(int), columns.astype(int))].astype(np.float32), equal_nan=True
    )
    [file] = export_raster(land / "store", tmp_path / "odd.exr", step=17.3 * FOOT)
    found = OpenEXR.File(str(file), separate_channels=True).parts[0].channels["Y"].pixels
    v, u = (np.arange(count) * 17.3 for count in found.shape)
    q, p = (np.minimum(at.astype(int), count - 2) for at, count in zip((v, u), heights.shape, strict=True))
    t, s = (v - q)[:, None], u - p
    south = heights[np.ix_(q, p)] * (1 - s) + heights[np.ix_(q, p + 1)] * s
    expected = south * (1 - t) + (heights[np.ix_(q + 1, p)] * (1 - s) + heights[np.ix_(q + 1, p + 1)] * s) * t
    known = ~np.isnan(expected) & ~np.isnan(found)
    assert known.mean() > 0.9 and np.abs(found - expected)[known].max() < 1e-3


@pytest.mark.parametrize(
    ("form", "flip"),
    [
        pytest.param("r32", True, marks=THOROUGH),
        ("r16", False),
        pytest.param("png", True, marks=THOROUGH),
        pytest.param("tif", False, marks=THOROUGH),
    ],
)
def test_tiles_hold_the_finest_heights(land, finest_heights, tmp_path, form, flip, monkeypatch):
    monkeypatch.setattr(height_tiles, "MAX_COLUMNS", 1 << 11)
    settings = HeightTiles(form, size=SIZE, step=FOOT, is_flipped=flip)
    index = export_height_tiles(open_store(land / "store"), tmp_path, settings)
    assert index == json.loads((tmp_path / "terrain.json").read_text())
    whole = finest_heights[::-1] if flip else finest_heights
    assert index["num_samples_on_terrain"] == list(whole.shape[::-1]) and len(index["tiles"]) > 4
    coding = index["heights"]
    for tile in index["tiles"]:
        path = tmp_path / tile["file"]
        if form.startswith("r"):
            numbers = np.fromfile(path, "<f4" if form == "r32" else "<u2").reshape(SIZE, SIZE)
        else:
            with rasterio.open(path) as file:
                numbers = file.read(1)
        wanted = whole[tile["row"] : tile["row"] + SIZE, tile["column"] : tile["column"] + SIZE]
        found = numbers[: wanted.shape[0], : wanted.shape[1]]
        if coding["scale"] == 1:
            known = ~np.isnan(wanted)
            assert (found[known] == wanted[known]).all() and (form == "r32" or np.isnan(found[~known]).all())
        else:
            off = np.abs(coding["offset"] + coding["scale"] * found - wanted)
            assert np.nanmax(off) <= coding["max_error"] + 1e-4
    assert coding["max_error"] <= (2e-4 if coding["scale"] == 1 else 0.51 * coding["scale"])


def test_one_tile_without_a_step_has_the_raster_samples(land, finest_heights, tmp_path):
    field = open_store(land / "store")
    export_height_tiles(field, tmp_path, HeightTiles("r32"))
    found = np.fromfile(tmp_path / "terrain_x0_y0.r32", "<f4").reshape(field.lattice.height, -1)
    heights = finest_heights[:: 1 << BITS, :: 1 << BITS]
    known = ~np.isnan(heights)
    assert (found[known] == heights[known]).all()


@pytest.mark.thorough
def test_masks_have_the_finer_slope(land, tmp_path):
    """The town has steps of up to 3 feet between its pixels of 1 foot."""
    west, north = TOWN
    bounds, medians, request = (
        (west + 140, north - 340, west + 380, north - 140),
        [],
        [AttributeRequest("slope", ("t",))],
    )
    for name, step in (("coarse", 0.0), ("fine", FOOT)):
        settings = HeightTiles("tif", name=name, step=step)
        index = export_height_tiles(open_store(land / "store"), tmp_path, settings, request)
        tile, mask = index["tiles"][0], next(mask for mask in index["masks"] if mask["name"] == "slope")
        with (
            rasterio.open(tmp_path / tile["file"]) as heights,
            rasterio.open(tmp_path / tile["masks"]["slope"]) as file,
        ):
            window = from_bounds(*bounds, heights.transform).round_offsets().round_lengths()
            medians.append(np.median(file.read(1, window=window)) * mask["scale"])
    assert medians[0] < 0.1 and 0.45 < medians[1] < 1.0


@pytest.mark.parametrize("suffix", [".tif", ".exr"])
def test_strips_and_columns_change_no_byte(land, tmp_path, suffix, monkeypatch):
    [whole] = export_raster(land / "store", tmp_path / f"a{suffix}", step=16 * FOOT)
    if suffix == ".exr":  # GeoTIFFs are written in a child process
        monkeypatch.setattr(exported_rows, "MAX_COLUMNS", 37)
    [parts] = export_raster(land / "store", tmp_path / f"b{suffix}", step=16 * FOOT)
    assert whole.read_bytes() == parts.read_bytes()


def test_impossible_steps_are_refused_before_any_file_is_written(land, tmp_path):
    field = open_store(land / "store")
    for step in (1e-9, 1e6):
        with pytest.raises(TerrainError, match="step of exported heights"):
            export_raster(land / "store", tmp_path / "a.tif", step=step)
        with pytest.raises(TerrainError, match="step of exported heights"):
            export_height_tiles(field, tmp_path, HeightTiles(step=step))
    with pytest.raises(TerrainError, match="exclude each other"):
        export_height_tiles(field, tmp_path, HeightTiles(size=65, tiles=(2, 2), step=1.0))
    assert not list(tmp_path.iterdir())


def test_steps_that_are_rounded_give_the_samples_of_the_raster(land):
    """Buttons keep float32 numbers, and users type few digits."""
    lattice = open_store(land / "store").lattice
    for step in (np.float32(FOOT), 0.3048006, FOOT * (1 + 5e-6)):
        for axis in grid_axes(lattice, float(step)):
            assert (axis.num, axis.den) == (1, 32) and axis.inside == (axis.samples - 1) * 32 + 1
    across, _ = grid_axes(lattice, 3 * lattice.step_x)
    assert (across.num, across.den) == (3, 1)
    across, _ = grid_axes(lattice, 0.7 * lattice.step_x)
    assert (across.num, across.den) == (7, 10)
    assert grid_axes(replace(lattice, step_y=2 * lattice.step_x), lattice.step_x)[1].den == 2


def test_a_bicubic_surface_is_exported_as_tiles(tmp_path, imported_hills):
    field = interpolated(imported_hills, "bicubic")
    for name, step in (("a", 0.0), ("b", 5.0)):
        export_height_tiles(field, tmp_path, HeightTiles("r32", name=name, step=step))
    coarse = np.fromfile(tmp_path / "a_x0_y0.r32", "<f4").reshape(30, 40)
    fine = np.fromfile(tmp_path / "b_x0_y0.r32", "<f4").reshape(59, 79)
    assert (fine[::2, ::2] == coarse).all()
    linear = (coarse[:, :-1] + coarse[:, 1:]) / 2
    assert 0.01 < np.abs(fine[::2, 1::2] - linear).max() < 20.0


@pytest.fixture
def imported_hills(tmp_path):
    """Return the field of 40 x 30 samples 10 m apart."""
    from rasters import hills, imported

    place = {"crs": "EPSG:32632", "transform": from_origin(5e5, 5e6, 10.0, 10.0)}
    return imported(tmp_path, write_raster(tmp_path / "hills.tif", hills(40, 30), **place))[0]
