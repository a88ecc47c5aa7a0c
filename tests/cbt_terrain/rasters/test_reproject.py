# SPDX-License-Identifier: GPL-3.0-or-later
"""Reprojection at import, against independent formulas."""

import math

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.georeference import border_error
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing import earlier_import
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.cli import command_line
from rasterio.transform import Affine, from_origin
from rasterio.warp import transform
from rasters import hills, imported, write_exr, write_raster
from transverse_mercator import utm_to_degrees

STEP = 1.0 / 120
WIDTH, HEIGHT, WEST, NORTH = 240, 120, 8.0, 60.5  # samples; degrees of the raster's corner


def degrees(tmp_path, heights, **options):
    return write_raster(
        tmp_path / "a.tif", heights, crs="EPSG:4326", transform=from_origin(WEST, NORTH, STEP, STEP), **options
    )


def positions(raster):
    """Longitude and latitude of every sample of a raster in UTM zone 32, and its column and row in the file."""
    place = raster.georeference
    x = place.middle[0] + (np.arange(raster.width) - (raster.width - 1) / 2) * place.step_x
    y = place.middle[1] - (np.arange(raster.height) - (raster.height - 1) / 2) * place.step_y
    longitude, latitude = utm_to_degrees(*np.meshgrid(x, y), 9.0)
    return (longitude - WEST) / STEP - 0.5, (NORTH - latitude) / STEP - 0.5


def test_utm_samples_lie_on_the_rasters_own_bilinear_surface(tmp_path):
    heights = hills(WIDTH, HEIGHT)
    raster = open_source(ImportSettings(source=str(degrees(tmp_path, heights)), project="utm"))
    rows = raster.read(0, raster.height)
    column, row = positions(raster)
    assert (raster.georeference.crs, raster.projected_from) == ("EPSG:32632", "EPSG:4326")
    inside = (column >= 0) & (column <= WIDTH - 1) & (row >= 0) & (row <= HEIGHT - 1)
    left, top = np.clip(column, 0, WIDTH - 2).astype(int), np.clip(row, 0, HEIGHT - 2).astype(int)
    s, t = column - left, row - top
    wanted = (heights[top, left] * (1 - s) + heights[top, left + 1] * s) * (1 - t)
    wanted += (heights[top + 1, left] * (1 - s) + heights[top + 1, left + 1] * s) * t
    steepest = max(np.abs(np.diff(heights, axis=0)).max(), np.abs(np.diff(heights, axis=1)).max())
    assert not np.isnan(rows[inside]).any() and np.mean(inside) > 0.9
    assert np.abs(rows - wanted)[inside].max() < 0.003 * steepest
    outside = (column < -0.51) | (column > WIDTH - 0.49) | (row < -0.51) | (row > HEIGHT - 0.49)
    assert outside.sum() > 100 and np.isnan(rows[outside]).all()
    # As dense as the file along each axis, at its middle: cells of 0.46 x 0.93 km.
    assert raster.georeference.step_x == pytest.approx(464.4, rel=2e-3)
    assert raster.georeference.step_y == pytest.approx(928.0, rel=2e-3)


def test_the_same_system_gives_the_same_samples(tmp_path):
    heights = hills(65, 33)
    source = write_raster(tmp_path / "a.tif", heights, crs="EPSG:32616", transform=from_origin(5e5, 4e6, 30.0, 20.0))
    field, report = imported(tmp_path, source, project="epsg:32616")
    assert np.array_equal(field.heights(), heights[::-1]) and report["step_m"] == pytest.approx([30.0, 20.0])
    assert field.origin.tolist() == pytest.approx([5e5 + 65 * 15.0, 4e6 - 33 * 10.0, 0.0])


def test_no_data_stays_missing_and_rounding_does_not_grow(tmp_path):
    """A hole stays one and mixes with nothing, nothing overshoots, and half a metre stays half a metre."""
    heights = np.round(hills(WIDTH, HEIGHT)).astype(np.int16)
    heights[40:60, 100:140] = -32768
    by_file = degrees(tmp_path, heights, nodata=-32768)
    raster = open_source(ImportSettings(source=str(by_file), project="utm"))
    rows = raster.read(0, raster.height)
    column, row = positions(raster)
    hole = (column > 100) & (column < 139) & (row > 40) & (row < 59)
    assert np.isnan(rows[hole]).all() and hole.sum() > 500
    far = (column > 1) & (column < WIDTH - 2) & (row > 1) & (row < HEIGHT - 2)
    far &= (column < 98) | (column > 141) | (row < 38) | (row > 61)
    assert not np.isnan(rows[far]).any()
    assert heights[heights > 0].min() <= np.nanmin(rows) and np.nanmax(rows) <= heights.max()
    field, report = imported(tmp_path, by_file, project="utm")
    steepest = max(np.nanmax(np.abs(np.diff(rows, axis=axis))) for axis in (0, 1))
    assert raster.moved < 0.004 * steepest and report["filled"] == np.isnan(rows).sum()
    assert report["source_step_m"] == pytest.approx(0.5 + raster.moved, abs=1e-4)
    assert report["bounds_against"] == "the raster as reprojected from EPSG:4326 to EPSG:32632, bilinear"
    plain = degrees(tmp_path, heights)
    given = open_source(ImportSettings(source=str(plain), project="utm", no_data=-32768.0)).read(0, raster.height)
    assert np.array_equal(given, rows, equal_nan=True)
    taken = open_source(ImportSettings(source=str(by_file), project="utm", no_data=math.nan)).read(0, raster.height)
    assert np.nanmin(taken) == -32768.0  # no value stands for missing


def test_blocks_of_rows_make_no_difference(tmp_path):
    raster = open_source(ImportSettings(source=str(degrees(tmp_path, hills(WIDTH, HEIGHT))), project="EPSG:3035"))
    whole = raster.read(0, raster.height)
    parts = [raster.read(first, 1) for first in range(raster.height)]
    assert np.array_equal(np.concatenate(parts), whole, equal_nan=True)


def sampled(source, raster):
    """Sample a file bilinearly at the positions of a raster, each transformed by PROJ; NaN beyond the file."""
    place = raster.georeference
    x = place.middle[0] + (np.arange(raster.width) - (raster.width - 1) / 2) * place.step_x
    y = place.middle[1] - (np.arange(raster.height) - (raster.height - 1) / 2) * place.step_y
    x, y = (values.ravel() for values in np.meshgrid(x, y))
    with rasterio.open(source) as file:
        heights = file.read(1).astype(np.float64)
        column, row = ~file.transform @ tuple(map(np.array, transform(place.crs, file.crs, x, y)))
    column, row = column - 0.5, row - 0.5
    inside = (column >= 0) & (column <= heights.shape[1] - 1) & (row >= 0) & (row <= heights.shape[0] - 1)
    left, top = (np.clip(v, 0, n - 2).astype(int) for v, n in zip((column, row), heights.shape[::-1], strict=True))
    s, t = column - left, row - top
    low = heights[top, left] * (1 - s) + heights[top, left + 1] * s
    high = heights[top + 1, left] * (1 - s) + heights[top + 1, left + 1] * s
    return np.where(inside, low * (1 - t) + high * t, np.nan).reshape(raster.height, raster.width)


FILES = {  # coordinate system, transform, target
    "degrees": ("EPSG:4326", from_origin(WEST, NORTH, STEP, STEP), "utm"),
    "rotated": ("EPSG:32632", Affine(30.0, 12.0, 5e5, 12.0, -30.0, 5.3e6), "EPSG:3035"),
    "mirrored": ("EPSG:32632", Affine(-30.0, 0.0, 5e5, 0.0, 30.0, 5.3e6), "EPSG:32633"),
    "feet": ("EPSG:2263", from_origin(9.8e5, 2e5, 30.0, 30.0), "EPSG:32618"),
    "other datum": ("EPSG:4267", from_origin(-100.0, 40.0, 1e-3, 1e-3), "EPSG:26914"),
}


@pytest.mark.parametrize("name", FILES)
def test_an_independent_sampler_agrees_within_the_stated_error(tmp_path, name):
    crs, place, target = FILES[name]
    source = write_raster(tmp_path / "a.tif", hills(300, 200).astype(np.float32), crs=crs, transform=place)
    raster = open_source(ImportSettings(str(source), project=target))
    rows, wanted = raster.read(0, raster.height), sampled(source, raster)
    known = ~np.isnan(wanted) & ~np.isnan(rows)
    assert known.mean() > 0.4 and (np.isnan(wanted) != np.isnan(rows)).mean() < 1e-3
    assert np.abs(rows - wanted)[known].max() <= raster.moved + 1e-9 < 1.0


def test_windows_of_another_reader_have_the_same_bytes(tmp_path):
    source = degrees(tmp_path, hills(WIDTH, HEIGHT))
    raster = open_source(ImportSettings(str(source), project="EPSG:3035"))
    whole = raster.read(0, raster.height)
    again = open_source(ImportSettings(str(source), project="EPSG:3035"))
    for first, count, column, columns in (37, 50, 11, 90), (0, 1, 100, 1), (90, 7, 0, raster.width):
        part = whole[first : first + count, column : column + columns]
        assert again.window(first, count, column, columns).tobytes() == part.tobytes()


def test_a_store_of_the_earlier_method_is_imported_again(tmp_path, monkeypatch):
    settings = ImportSettings(str(degrees(tmp_path, hills(WIDTH, HEIGHT))), project="utm")
    monkeypatch.setattr(earlier_import, "RESAMPLING", 0)
    run_import(settings, tmp_path / "s")
    assert earlier_import.finished_import(tmp_path / "s", settings) is not None
    monkeypatch.undo()
    assert earlier_import.finished_import(tmp_path / "s", settings) is None
    run_import(settings, tmp_path / "s")
    assert earlier_import.finished_import(tmp_path / "s", settings)["unchanged"]


def test_a_world_beyond_which_there_are_no_positions(tmp_path):
    """Nodes beyond the poles have no position. Up to 20 of them raise an error each in GDAL."""
    latitude = 90.0 - np.arange(0.5, 180.0)
    heights = np.repeat(latitude[:, None], 360, axis=1).astype(np.float32)
    source = write_raster(tmp_path / "a.tif", heights, crs="EPSG:4326", transform=from_origin(-180.0, 90.0, 1.0, 1.0))
    raster = open_source(ImportSettings(str(source), project="EPSG:8857"))
    rows = raster.read(0, raster.height)
    wanted = sampled(source, raster)
    known = ~np.isnan(wanted) & ~np.isnan(rows)
    assert known.mean() > 0.7 and np.abs(rows - wanted)[known].max() <= raster.moved + 1e-9


BAD_PROJECTIONS = [
    ("EPSG:999999", "EPSG:999999 is no coordinate system that PROJ knows"),
    ("EPSG:4979", "does not measure in metres or feet"),
    ("EPSG:4326", "does not measure in metres or feet"),
    ("EPSG:5773", "does not measure in metres or feet"),
    ("mercator", "expected utm or EPSG:n"),
    ("EPSG:32632 ", "expected utm or EPSG:n"),
]


@pytest.mark.parametrize("project, said", BAD_PROJECTIONS)
def test_systems_that_cannot_be_used_are_refused(tmp_path, project, said):
    source = degrees(tmp_path, hills(WIDTH, HEIGHT))
    with pytest.raises(TerrainError, match=f"{said}.*[.]$"):
        open_source(ImportSettings(source=str(source), project=project))


def test_sources_without_a_system_are_refused(tmp_path):
    plain = write_raster(tmp_path / "plain.tif", hills(9, 9))
    for source in (plain, write_exr(tmp_path / "a.exr", Y=hills(9, 9)), "island"):
        with pytest.raises(TerrainError, match="no coordinate system, so it cannot be reprojected: .*[.]$"):
            open_source(ImportSettings(source=str(source), project="utm"))
    polar = {"crs": "EPSG:4326", "transform": from_origin(0.0, 89.5, 0.1, 0.1)}
    with pytest.raises(TerrainError, match="latitude 89.* EPSG:3413"):
        open_source(ImportSettings(source=str(write_raster(tmp_path / "b.tif", hills(9, 9), **polar)), project="utm"))
    polar["transform"] = from_origin(0.0, 90.5, 0.1, 0.1)
    with pytest.raises(TerrainError, match="EPSG:3857.*: choose another system.$"):
        open_source(
            ImportSettings(source=str(write_raster(tmp_path / "b.tif", hills(9, 9), **polar)), project="EPSG:3857")
        )


def test_the_error_at_the_rim_of_degrees_is_said(tmp_path):
    """5 degrees at 60 N: a degree of longitude at 62.5 N is cos 62.5 / cos 60 as long, so 8 % too much is taken."""
    wide = {"crs": "EPSG:4326", "transform": from_origin(0.0, 62.5, 0.1, 0.1)}
    source = write_raster(tmp_path / "a.tif", hills(50, 50), **wide)
    [warning] = imported(tmp_path, source)[1]["warnings"]
    assert "off by up to 8.3 %" in warning
    assert warning.endswith("import it with utm or EPSG:n as Reproject (--project).")
    sphere = math.cos(math.radians(60.0)) / math.cos(math.radians(62.5)) - 1.0
    assert border_error(60.0, [57.5, 62.5]) == pytest.approx(sphere, rel=0.01) and sphere == pytest.approx(
        0.083, abs=5e-4
    )
    assert imported(tmp_path, source, extent=(1e5, 1e5))[1]["warnings"] == []
    assert imported(tmp_path, source, project="utm")[1]["warnings"] == []
    small = {"crs": "EPSG:4326", "transform": from_origin(0.0, 60.0, 0.0001, 0.0001)}
    assert imported(tmp_path, write_raster(tmp_path / "b.tif", hills(50, 50), **small))[1]["warnings"] == []
    pole = {"crs": "EPSG:4326", "transform": from_origin(-180.0, 90.0, 2.0, 1.0)}
    [warning] = imported(tmp_path, write_raster(tmp_path / "c.tif", hills(180, 180), **pole))[1]["warnings"]
    assert "a pole is near" in warning


def test_project_on_the_command_line(tmp_path, capsys):
    """PROJ finds its database in the sandbox, and `info` describes the result of an import."""
    source = degrees(tmp_path, hills(WIDTH, HEIGHT))
    assert command_line.main(["info", str(source), "--project", "utm"]) == 0
    said = capsys.readouterr().out
    assert "crs: EPSG:32632" in said and "warning" not in said
    assert command_line.main(["import", str(source), "--project", "EPSG:25832", "--store", str(tmp_path / "s")]) == 0
    assert "bounds_against: the raster as reprojected from EPSG:4326 to EPSG:25832, bilinear" in capsys.readouterr().out
