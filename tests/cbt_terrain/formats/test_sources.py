# SPDX-License-Identifier: GPL-3.0-or-later
"""Every kind of source, its georeference, its no-data and its vertical scale."""

import json
import math
import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.georeference import degree_lengths, ellipsoid_of, from_transform
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings, Raster
from rasterio.transform import Affine, from_origin
from rasters import hills, jacksboro, write_exr, write_raster

SHAPE = 33, 65  # rows, columns: fits a lattice, so that samples must come through unchanged


def heights_16_bit():
    return np.round(hills(SHAPE[1], SHAPE[0])).astype(np.int16)


def imported(tmp_path, source, **settings):
    """Import in this process and return the field and the report."""
    report = run_import(ImportSettings(source=str(source), **settings), tmp_path / "store")
    json.dumps(report)
    return open_store(tmp_path / "store"), report


def test_geotiff_with_metres(tmp_path):
    heights = hills(SHAPE[1], SHAPE[0])
    place = {"crs": "EPSG:32616", "transform": from_origin(500000.0, 4000000.0, 30.0, 20.0)}
    source = write_raster(tmp_path / "a.tif", heights, **place)
    field, report = imported(tmp_path, source)
    assert np.array_equal(field.heights(), heights[::-1])  # row 0 is the south edge
    assert report["step_m"] == [30.0, 20.0] and report["extent_m"] == [64 * 30.0, 32 * 20.0]
    assert field.crs == "EPSG:32616"
    assert field.origin.tolist() == [500000.0 + 65 * 15.0, 4000000.0 - 33 * 10.0, 0.0]
    assert report["warnings"] == [] and report["filled"] == 0


LAYOUTS = {
    "tiled": {"tiled": True, "blockxsize": 16, "blockysize": 16, "compress": "deflate"},
    "one strip": {"blockysize": 33, "compress": "lzw"},
    "BigTIFF": {"BIGTIFF": "YES"},
    "COG": {"driver": "COG"},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_tiff(tmp_path, layout):
    heights = heights_16_bit()
    field, _ = imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **LAYOUTS[layout]))
    assert np.array_equal(field.heights(), heights[::-1])


def test_geotiff_in_degrees_is_measured_at_its_middle_latitude(tmp_path):
    step = 1.0 / 1200
    transform = from_origin(10.0, 47.0, step, step)
    source = write_raster(tmp_path / "a.tif", heights_16_bit(), crs="EPSG:4326", transform=transform)
    _, report = imported(tmp_path, source)
    per_x, per_y = degree_lengths(47.0 - 33 * step / 2)
    assert report["step_m"] == pytest.approx([per_x * step, per_y * step], rel=1e-12)


def test_degrees_have_the_ellipsoids_lengths():
    # Length of a degree on WGS 84 (National Geospatial-Intelligence Agency's tables).
    for latitude, wanted in ((0.0, (111319.49, 110574.28)), (45.0, (78846.81, 111131.78)), (60.0, (55800.0, 111412.2))):
        assert degree_lengths(latitude) == pytest.approx(wanted, abs=0.1)
    x, y = degree_lengths(30.0, (1000.0, 0.0))  # a sphere
    assert (x, y) == pytest.approx((1000.0 * math.radians(1) * math.cos(math.radians(30)), 1000.0 * math.radians(1)))
    assert ellipsoid_of('GEOGCS["x",DATUM["y",SPHEROID["Clarke 1866",6378206.4,294.978698213898]]]') == (
        6378206.4,
        294.978698213898,
    )


def test_feet_become_metres(tmp_path):
    source = write_raster(tmp_path / "a.tif", heights_16_bit(), crs="EPSG:2263", transform=from_origin(0, 0, 10, 10))
    assert imported(tmp_path, source)[1]["step_m"] == pytest.approx([10 * 1200 / 3937] * 2)


def test_a_raster_that_begins_in_the_south_is_not_turned(tmp_path):
    heights = heights_16_bit()
    source = write_raster(tmp_path / "a.tif", heights, transform=Affine(5, 0, 0, 0, 5, 0))
    field, _ = imported(tmp_path, source)
    assert np.array_equal(field.heights(), heights)


def test_a_rotated_raster_keeps_its_cells_lengths_and_warns(tmp_path):
    cosine, sine = 0.8, 0.6
    turned = Affine(10 * cosine, 20 * sine, 1000, 10 * sine, -20 * cosine, 2000)
    _, report = imported(
        tmp_path, write_raster(tmp_path / "a.tif", heights_16_bit(), transform=turned, crs="EPSG:32616")
    )
    assert report["step_m"] == pytest.approx([10.0, 20.0])
    assert any("rotated" in warning for warning in report["warnings"])


def test_the_extent_or_one_metre_replaces_a_georeference(tmp_path):
    source = write_raster(tmp_path / "a.png", heights_16_bit().astype(np.uint16))
    assert imported(tmp_path, source)[1]["step_m"] == [1.0, 1.0]
    assert imported(tmp_path, source, extent=(6400.0, 1600.0))[1]["step_m"] == [100.0, 50.0]


def test_an_ascii_grid_in_unnamed_degrees_is_warned_about(tmp_path):
    path = tmp_path / "a.asc"
    rows = "\n".join(" ".join(map(str, row)) for row in heights_16_bit())
    path.write_text(f"ncols 65\nnrows 33\nxllcorner 10\nyllcorner 47\ncellsize 0.000833\nNODATA_value -9999\n{rows}\n")
    field, report = imported(tmp_path, path)
    assert np.array_equal(field.heights(), heights_16_bit()[::-1])
    assert "degrees" in report["warnings"][0]


def test_hgt(tmp_path):
    heights = np.full((1201, 1201), 100, ">i2")
    heights[0, 0], heights[5, 7] = 321, -32768
    heights.tofile(tmp_path / "N36W085.hgt")
    field, report = imported(tmp_path, tmp_path / "N36W085.hgt")
    per_x, per_y = degree_lengths(36.5)
    assert report["extent_m"] == pytest.approx([per_x, per_y], rel=1e-9)  # samples on both edges of the degree
    assert field.origin.tolist() == pytest.approx([-84.5, 36.5, 0.0])
    assert field.heights()[-1, 0] == 321.0 and report["filled"] == 1 and field.min_height == 100.0


def test_vrt(tmp_path):
    heights = heights_16_bit()
    write_raster(tmp_path / "part.tif", heights, crs="EPSG:32616", transform=from_origin(0, 0, 10, 10))
    (tmp_path / "a.vrt").write_text(
        '<VRTDataset rasterXSize="65" rasterYSize="33"><VRTRasterBand dataType="Int16" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">part.tif</SourceFilename><SourceBand>1</SourceBand></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    assert np.array_equal(imported(tmp_path, tmp_path / "a.vrt")[0].heights(), heights[::-1])


@pytest.mark.parametrize("kind", ["float32", "float16", "uint32"])
def test_exr(tmp_path, kind):
    heights = heights_16_bit().astype(kind)
    field, report = imported(tmp_path, write_exr(tmp_path / "a.exr", Y=heights), extent=(6400.0, 3200.0))
    assert np.array_equal(field.heights(), heights[::-1].astype(np.float32))
    assert bool(report["warnings"]) == (kind == "float16")


def test_exr_channels_are_found_or_named(tmp_path):
    low, high = heights_16_bit().astype(np.float32), heights_16_bit().astype(np.float32) + 1000.0
    source = write_exr(tmp_path / "a.exr", mask=low, height=high)
    assert imported(tmp_path, source)[0].min_height > 1000.0
    assert imported(tmp_path, source, channel="mask")[0].min_height < 1000.0
    with pytest.raises(TerrainError, match="no channel 'depth': choose one of"):
        imported(tmp_path, source, channel="depth")


@pytest.mark.parametrize("kind", ["<u2", ">u2", "<i2", ">i2", "<f4", ">f4", "<f8"])
def test_raw(tmp_path, kind):
    heights = heights_16_bit()
    heights.astype(kind).tofile(tmp_path / "a.raw")
    settings = {"raw_dtype": np.dtype(kind).name, "raw_little_endian": kind[0] == "<", "height_scale": 1.0}
    field, _ = imported(tmp_path, tmp_path / "a.raw", raw_size=(65, 33), **settings)
    assert np.array_equal(field.heights(), heights[::-1])
    south = imported(tmp_path, tmp_path / "a.raw", raw_size=(65, 33), first_row_south=True, **settings)[0]
    assert np.array_equal(south.heights(), heights)


def test_a_square_raw_needs_no_size(tmp_path):
    hills(33, 33).astype("<u2").tofile(tmp_path / "a.r16")
    assert imported(tmp_path, tmp_path / "a.r16")[1]["raster"] == [33, 33]


def test_npy(tmp_path):
    heights = hills(65, 33).astype(">f8")
    np.save(tmp_path / "a.npy", heights)
    field, _ = imported(tmp_path, tmp_path / "a.npy")
    assert np.array_equal(field.heights(), heights[::-1].astype(np.float32))


def test_island(tmp_path):
    field, report = imported(tmp_path, "island", size=65)
    assert report["extent_m"] == [8192.0, 8192.0] and field.lattice.levels == 6


def test_vertical_scale_and_offset(tmp_path):
    heights = heights_16_bit()
    source = write_raster(tmp_path / "a.tif", heights)
    field, _ = imported(tmp_path, source, height_scale=0.5, height_offset=-100.0)
    assert np.array_equal(field.heights(), heights[::-1] * 0.5 - 100.0)


def test_the_files_own_scale_offset_and_unit_come_first(tmp_path):
    import rasterio

    heights = heights_16_bit()
    source = write_raster(tmp_path / "a.tif", heights)
    with rasterio.open(source, "r+") as file:
        file.scales, file.offsets, file.units = (0.1,), (5.0,), ("ft",)
    field, report = imported(tmp_path, source, height_scale=2.0)
    assert np.allclose(field.heights(), (heights[::-1] * 0.1 + 5.0) * 0.3048 * 2.0, rtol=1e-6)
    assert "ft" in report["warnings"][0]


def test_no_data_by_file_by_mask_and_by_value(tmp_path):
    heights = heights_16_bit()
    heights[3:5, 10:20] = -9999
    by_file = write_raster(tmp_path / "a.tif", heights, nodata=-9999)
    plain = write_raster(tmp_path / "b.tif", heights)
    assert imported(tmp_path, by_file)[1]["filled"] == 20
    assert imported(tmp_path, plain)[1]["filled"] == 0
    field, report = imported(tmp_path, plain, no_data=-9999.0)
    assert report["filled"] == 20 and field.min_height > 0.0
    assert imported(tmp_path, by_file, no_data=math.nan)[0].min_height == -9999.0  # no value stands for missing


def test_a_no_data_value_that_the_type_cannot_hold_is_none(tmp_path):
    source = write_raster(tmp_path / "a.tif", heights_16_bit())
    assert imported(tmp_path, source, no_data=-9999.5)[1]["filled"] == 0
    assert imported(tmp_path, source, no_data=1e30)[1]["filled"] == 0


def test_colour_and_8_bit_pictures_are_warned_about(tmp_path):
    import rasterio

    picture = np.arange(64, dtype=np.uint8).reshape(1, 8, 8)
    with rasterio.open(tmp_path / "a.png", "w", driver="PNG", width=8, height=8, count=3, dtype="uint8") as file:
        file.write(np.repeat(picture, 3, axis=0))
    warnings = imported(tmp_path, tmp_path / "a.png", extent=(700.0, 700.0), height_scale=1.0)[1]["warnings"]
    assert len(warnings) == 2 and "3 channels" in warnings[0] and "256 steps" in warnings[1]


def test_palette_numbers_are_warned_about(tmp_path):
    import rasterio

    for name, driver in (("a.tif", "GTiff"), ("a.png", "PNG")):
        with rasterio.open(tmp_path / name, "w", driver=driver, width=8, height=8, count=1, dtype="uint8") as file:
            file.write(np.arange(64, dtype=np.uint8).reshape(1, 8, 8))
            file.write_colormap(1, {i: (i, 255 - i, 0, 255) for i in range(256)})
        assert "colours in a palette, not heights" in imported(tmp_path, tmp_path / name)[1]["warnings"][0]


def test_a_georeference_that_coordinates_cannot_hold_is_refused(tmp_path):
    source = write_raster(
        tmp_path / "a.tif", heights_16_bit(), crs="EPSG:32616", transform=from_origin(0.0, 0.0, 1e40, 1.0)
    )
    with pytest.raises(TerrainError, match="a.tif is .* large by its georeference"):
        imported(tmp_path, source)


def test_what_is_no_regular_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.tif")
    for source in (tmp_path / "pipe.tif", "/dev/null"):
        with pytest.raises(TerrainError, match="is not a regular file"):
            open_source(ImportSettings(source=str(source)))
    with pytest.raises(TerrainError, match="cannot be read .File name too long"):
        open_source(ImportSettings(source=f"{'x' * 300}.tif"))


def test_blocks_of_rows_make_no_difference(tmp_path, monkeypatch):
    from adaptive_terrain.cbt_terrain.rasters import raster as importing

    heights = hills(65, 61)
    source = write_raster(tmp_path / "a.tif", heights, blockysize=7)
    whole = imported(tmp_path, source)[0].key
    monkeypatch.setattr(importing, "BLOCK_SAMPLES", 100)
    assert imported(tmp_path, source)[0].key == whole


BAD_SETTINGS = [
    ({"extent": (0.0, 10.0)}, "extent"),
    ({"extent": (math.inf, 10.0)}, "extent"),
    ({"extent": (1e-31, 10.0)}, "extent .* between 1e-30 and 1e\\+30 m"),
    ({"extent": (10.0, 1e31)}, "extent"),
    ({"extent": (10.0, 10**400)}, "extent"),
    ({"height_scale": 0.0}, "scale"),
    ({"height_offset": math.nan}, "offset"),
    ({"raw_dtype": "complex64"}, "choose one of uint8"),
    ({"raw_size": (0, 5)}, "two positive counts"),
    ({"source": "island", "size": 1}, "expected 2 to"),
]


@pytest.mark.parametrize("changes, message", BAD_SETTINGS)
def test_settings_that_mean_nothing_are_refused(changes, message):
    with pytest.raises(TerrainError, match=message):
        open_source(ImportSettings(**({"source": "a.tif"} | changes)))


def test_places_that_have_no_size_are_refused():
    with pytest.raises(TerrainError, match="no size"):
        from_transform((0.0, 0.0, 0.0, 0.0, -1.0, 0.0), 10, 10)
    with pytest.raises(TerrainError, match="latitude 90"):
        from_transform((0.1, 0.0, 0.0, 0.0, -0.1, 90.05), 1, 1, degrees=1.0)
    with pytest.raises(TerrainError, match="no size"):
        from_transform((math.nan, 0.0, 0.0, 0.0, -1.0, 0.0), 10, 10)


def test_every_file_format_gives_the_same_terrain(tmp_path):
    heights = jacksboro()
    rows, columns = heights.shape
    padded = np.full((1201, 1201), -32768, ">i2")
    padded[:rows, :columns] = heights
    padded.tofile(tmp_path / "N36W085.hgt")
    heights.astype("<u2").tofile(tmp_path / "a.r16")
    np.save(tmp_path / "a.npy", heights)
    degrees = {"crs": "EPSG:4326", "transform": from_origin(-84.41375, 36.73291667, 1 / 1200, 1 / 1200)}
    sources = [
        write_raster(tmp_path / "a.tif", heights, **degrees),
        write_exr(tmp_path / "a.exr", Y=heights.astype(np.float32)),
        write_raster(tmp_path / "a.png", heights.astype(np.uint16)),
        write_raster(tmp_path / "a.asc", heights, transform=from_origin(0, 0, 90, 90)),
        tmp_path / "a.r16",
        tmp_path / "a.npy",
    ]
    settings, raw = {"extent": (30000.0, 31000.0), "height_scale": 1.0}, {"raw_size": (columns, rows)}
    fields = [imported(tmp_path, s, **settings, **(raw if s.suffix == ".r16" else {}))[0] for s in sources]
    assert len({field.heights().tobytes() for field in fields}) == 1
    whole, exr = fields[:1] + fields[2:], fields[1]
    assert len({field.key for field in whole}) == 1 and {field.source_max for field in whole} == {0.5}
    assert exr.key != whole[0].key and exr.source_max == 2.0**-14  # floats leave less open
    field = fields[0]
    assert (field.min_height, field.max_height) == (236.0, 1076.0)
    assert np.array_equal(field.heights(), heights[::-1]) and field.lattice.is_padded
    tile, report = imported(tmp_path, tmp_path / "N36W085.hgt")
    assert report["filled"] == 1201 * 1201 - rows * columns
    assert (tile.min_height, tile.max_height) == (236.0, 1076.0)


def test_a_raster_reads_by_rows():
    raster = open_source(ImportSettings(source="island", size=17))
    assert isinstance(raster, Raster)
    assert np.array_equal(raster.read(3, 5), raster.read(0, 17)[3:8])
