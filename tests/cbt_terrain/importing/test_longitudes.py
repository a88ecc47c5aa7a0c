# SPDX-License-Identifier: GPL-3.0-or-later
"""Longitudes beyond 180 degrees, and rasters that cross the antimeridian."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.placing import Placing, placing_of, unit_lengths
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import Affine, from_origin
from rasters import imported, write_raster
from transverse_mercator import utm_to_degrees

STEP, WIDTH, HEIGHT = 1.0 / 120, 60, 36


def ground(longitude, latitude, middle):
    """Return a plane over degrees, of a raster with the middle longitude `middle`."""
    return 500.0 + 400.0 * (longitude - middle) + 900.0 * (latitude - 60.0)


def degrees(tmp_path, west, crs="EPSG:4326"):
    longitude = west + (np.arange(WIDTH) + 0.5) * STEP
    latitude = 60.15 - (np.arange(HEIGHT) + 0.5) * STEP
    heights = ground(*np.meshgrid(longitude, latitude), west + WIDTH * STEP / 2).astype(np.float32)
    return write_raster(tmp_path / "a.tif", heights, crs=crs, transform=from_origin(west, 60.15, STEP, STEP))


# West border, the code of UTM's zone of the middle, and its central meridian in the same turn.
RASTERS = {
    "10 east": (10.0, "EPSG:32632", 9.0),
    "290 east": (290.0, "EPSG:32619", 291.0),
    "359.75 east, across Greenwich": (359.75, "EPSG:32631", 363.0),
    "across 180, mostly west of it": (179.7, "EPSG:32660", 177.0),
    "across 180, mostly east of it": (179.8, "EPSG:32601", 183.0),
    "across -180": (-180.2, "EPSG:32601", -177.0),
}


@pytest.mark.parametrize("name", RASTERS)
def test_utm_of_any_longitudes(tmp_path, name):
    west, code, meridian = RASTERS[name]
    raster = open_source(ImportSettings(str(degrees(tmp_path, west)), project="utm"))
    rows, place = raster.read(0, raster.height), raster.georeference
    assert place.crs == code
    x = place.middle[0] + (np.arange(raster.width) - (raster.width - 1) / 2) * place.step_x
    y = place.middle[1] - (np.arange(raster.height) - (raster.height - 1) / 2) * place.step_y
    longitude, latitude = utm_to_degrees(*np.meshgrid(x, y), meridian)
    column, row = (longitude - west) / STEP - 0.5, (60.15 - latitude) / STEP - 0.5
    inside = (column >= 0) & (column <= WIDTH - 1) & (row >= 0) & (row <= HEIGHT - 1)
    assert inside.mean() > 0.85 and not np.isnan(rows[inside]).any()
    wanted = ground(longitude, latitude, west + WIDTH * STEP / 2)
    assert np.abs(rows - wanted)[inside].max() < 0.02  # a cell rises by 7.5 m


@pytest.mark.parametrize("code", [4267, 4284, 4269], ids=["NAD27", "Pulkovo 1942", "NAD83"])
def test_datums_count_across_the_antimeridian(tmp_path, code):
    """The same samples, with longitudes in either turn."""
    first, second = (
        open_source(ImportSettings(str(degrees(tmp_path, west, f"EPSG:{code}")), project="EPSG:32601"))
        for west in (-179.9, 180.1)
    )
    assert first.georeference.middle == pytest.approx(second.georeference.middle, abs=1e-3)
    rows = first.read(0, first.height), second.read(0, second.height)
    assert np.nanmax(np.abs(rows[0] - rows[1])) < 0.01 and np.array_equal(*map(np.isnan, rows))


def test_a_grid_of_the_whole_earth_from_0_to_360(tmp_path):
    longitude, latitude = np.meshgrid(np.arange(0.5, 360.0), 90.0 - np.arange(0.5, 180.0))
    heights = (np.where(longitude < 180.0, longitude, longitude - 360.0) * 10.0 + latitude).astype(np.float32)
    source = write_raster(tmp_path / "a.tif", heights, crs="EPSG:4326", transform=from_origin(0.0, 90.0, 1.0, 1.0))
    raster = open_source(ImportSettings(str(source), project="EPSG:6933"))  # equal area, -180 to 180
    rows, place = raster.read(0, raster.height), raster.georeference
    x = place.middle[0] + (np.arange(raster.width) - (raster.width - 1) / 2) * place.step_x
    middle = rows[raster.height // 2]
    found = (np.abs(x / 17367530.445 * 180.0) < 179.0) & (np.abs(x) > 1e5)  # but for the file's first and last column
    y = place.middle[1] + ((raster.height - 1) / 2 - raster.height // 2) * place.step_y
    latitude = np.degrees(np.arcsin(2.0 * y / 14631e3))  # close to the equator the sphere's will do
    assert not np.isnan(middle[found]).any() and found.sum() > 340
    assert middle[found] == pytest.approx(x[found] / 17367530.445 * 1800.0 + latitude, abs=1.0)


def test_either_turn_of_a_longitude_is_the_same_place(tmp_path):
    for west in (290.0, 179.8, -70.0):
        field, _ = imported(tmp_path, degrees(tmp_path, west))
        placing = Placing(*(float(c) for c in field.origin[:2]), *unit_lengths(field), field.crs, 360.0)
        places = np.array([(west + 0.1, 60.0), (west + 0.4, 60.1)])
        wanted = ground(places[:, 0], places[:, 1], west + WIDTH * STEP / 2)
        for turn in (-360.0, 0.0, 360.0):
            found = ground_at(field, placing.to_terrain(places + (turn, 0.0))).heights
            assert found == pytest.approx(wanted, abs=1e-3)
        back = placing.from_terrain(placing.to_terrain(places + (360.0, 0.0)))
        assert back == pytest.approx(places)
    assert Placing(5e5, 5e6, crs="EPSG:32632").to_terrain(np.array([(5e5 + 360.0, 5e6)])).tolist() == [[360.0, 0.0]]
    assert placing_of(tmp_path / "store") == placing


def test_utm_passes_from_zone_60_to_zone_1(tmp_path):
    """60 N, 180 E is 667 km east in zone 60, 333 km east in zone 1; rows there are oblique by 5 degrees."""
    transform = Affine(100.0, 0.0, 665_000.0, 0.0, -100.0, 6_656_000.0)
    row, column = np.mgrid[0:40, 0:50] + 0.5
    x, y = transform @ (column, row)
    heights = (0.01 * (x - 667_000.0) + 0.02 * (y - 6_654_000.0)).astype(np.float32)
    source = write_raster(tmp_path / "a.tif", heights, crs="EPSG:32660", transform=transform)
    raster = open_source(ImportSettings(str(source), project="EPSG:32601"))
    rows, place = raster.read(0, raster.height), raster.georeference
    x = place.middle[0] + (np.arange(raster.width) - (raster.width - 1) / 2) * place.step_x
    y = place.middle[1] - (np.arange(raster.height) - (raster.height - 1) / 2) * place.step_y
    x, y = np.meshgrid(x, y)
    inside = ~np.isnan(rows)
    assert inside.mean() > 0.7
    longitude, latitude = utm_to_degrees(x[inside], y[inside], 183.0)
    from rasterio.warp import transform as moved

    west = np.where(longitude > 180.0, longitude - 360.0, longitude)
    x, y = map(np.array, moved("EPSG:4326", "EPSG:32660", west, latitude))
    near = (np.abs(x - 667_500.0) < 2_300.0) & (np.abs(y - 6_654_000.0) < 1_900.0)
    assert np.abs(rows[inside] - 0.01 * (x - 667_000.0) - 0.02 * (y - 6_654_000.0))[near].max() < 0.01


def test_what_passes_the_edge_of_its_own_system_is_refused(tmp_path):
    transform = Affine(100.0, 0.0, 20037508.0 - 2_000.0, 0.0, -100.0, 8.4e6)
    source = write_raster(tmp_path / "a.tif", np.ones((30, 50), np.float32), crs="EPSG:3857", transform=transform)
    with pytest.raises(TerrainError, match="passes the edge of its coordinate system EPSG:3857.*gdalwarp -te"):
        open_source(ImportSettings(str(source), project="utm"))
