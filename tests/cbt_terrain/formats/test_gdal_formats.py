# SPDX-License-Identifier: GPL-3.0-or-later
"""Formats read through GDAL, compared with files that independent code wrote."""

import os

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats import format_choice
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters import driver_gaps, source_formats
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.sandbox import guard
from height_files import (
    COLUMNS,
    DEGREES,
    METRES,
    ROWS,
    WRITERS,
    heights,
    through_gdal,
    write_bt,
    write_netcdf,
    write_saga,
    write_surfer6,
    write_terragen,
    write_usgs_dem,
    write_xyz,
)
from rasters import imported, write_raster
from sandboxed_reads import read_in_sandbox


@pytest.mark.parametrize("name", WRITERS)
def test_samples_position_and_no_data_are_those_written(tmp_path, name):
    """Heights, no-data, the positions of samples and the coordinate system agree with the writer."""
    write, (west, south, step), crs = WRITERS[name]
    wanted = heights()
    source = write(tmp_path / name, wanted, west, south, step)
    raster = open_source(ImportSettings(str(source)))
    place = raster.georeference
    rows = place.in_file_order(np.empty((ROWS, COLUMNS)))
    rows[:] = raster.read(0, ROWS) * raster.scale + raster.offset
    found = rows if rows.base is None else rows.base  # row 0 south
    raster.close()
    assert np.array_equal(found[::-1], wanted, equal_nan=True) and place.crs == crs
    middle = west + step * (COLUMNS - 1) / 2, south + step * (ROWS - 1) / 2
    assert place.middle == pytest.approx(middle, abs=1e-6, rel=1e-12)  # a GRIB has microdegrees
    if crs != "EPSG:4326":
        assert (place.step_x, place.step_y) == pytest.approx((step, step), rel=1e-9)


@pytest.mark.thorough
def test_every_format_is_read_in_the_sandbox(tmp_path):
    """Each format is read where the network, programs and all writing are given up, with its own driver alone."""
    files = [write(tmp_path / name, heights(), *place) for name, (write, place, _) in WRITERS.items()]
    wanted = [COLUMNS, ROWS, float(np.nansum(heights())), 1]
    found = read_in_sandbox(files)
    assert dict(zip(WRITERS, found, strict=True)) == dict.fromkeys(WRITERS, ["read", wanted])
    report = import_source(ImportSettings(str(tmp_path / "a.nc")), tmp_path / "store")
    assert (report["samples"], report["filled"], report["lowest_m"]) == ([COLUMNS, ROWS], 1, -7.0)


def raster_of(source, **settings):
    raster = open_source(ImportSettings(str(source), **settings))
    rows = raster.read(0, raster.height) * raster.scale + raster.offset
    raster.close()
    return raster, rows


def test_heights_in_other_units_become_metres(tmp_path):
    wanted, foot = heights(), 0.3048
    feet = write_usgs_dem(tmp_path / "feet.dem", wanted, *METRES, unit=1)
    tenths = write_usgs_dem(tmp_path / "tenths.dem", wanted, *METRES, resolution=0.1)
    scaled = write_bt(tmp_path / "scaled.bt", wanted, *METRES, scale=0.1)
    of_feet = write_bt(tmp_path / "feet.bt", wanted, *METRES, scale=foot)
    saga = write_saga(tmp_path / "a.sdat", wanted, *METRES, factor=0.5, unit="ft")
    packed = (("scale_factor", 0.5), ("add_offset", 3.0))
    grid = write_netcdf(tmp_path / "a.nc", wanted, *METRES, units=("m", "m", "feet"), attributes=packed)
    for source, factor, offset in (
        (feet, foot, 0.0),
        (tenths, 1.0, 0.0),
        (scaled, 0.1, 0.0),
        (of_feet, foot, 0.0),
        (saga, 0.5 * foot, 0.0),
        (grid, 0.5 * foot, 3.0 * foot),
    ):
        _, rows = raster_of(source)
        assert np.allclose(rows, wanted * factor + offset, rtol=1e-6, atol=0, equal_nan=True), source.name


def test_a_geopotential_becomes_a_height():
    class Message:
        driver, units = "GRIB", (None,)
        tags = staticmethod(lambda _band: {"GRIB_UNIT": "[(m^2)/(s^2)]"})

    facts = driver_gaps.band_facts(None, Message, 1, None)
    assert (facts.unit, facts.factor) == ("m", pytest.approx(1 / 9.80665))


@pytest.mark.parametrize("offset", [None, 0, 1])
@pytest.mark.parametrize("south_first", [True, False])
@pytest.mark.parametrize("names", [("x", "y", "z"), ("lon", "lat", "elevation"), ("easting", "northing", "h")])
def test_grids_of_gmt_keep_position_and_direction(tmp_path, names, south_first, offset):
    """Both registrations of GMT have samples at their coordinates, by nodes or in the middle of pixels."""
    place = DEGREES if names[0] == "lon" else METRES
    source = write_netcdf(tmp_path / "a.nc", heights(), *place, names=names, south_first=south_first, offset=offset)
    raster, rows = raster_of(source)
    rows = rows[::-1] if raster.georeference.first_row_south else rows
    assert np.array_equal(rows, heights(), equal_nan=True)
    assert raster.georeference.crs == ("EPSG:4326" if place is DEGREES else "")
    west, south, step = place
    wanted = west + step * (COLUMNS - 1) / 2, south + step * (ROWS - 1) / 2
    assert raster.georeference.middle == pytest.approx(wanted, rel=1e-9)


def test_coordinates_in_degrees_name_wgs_84(tmp_path):
    units = ("degrees_east", "degrees_north", "m")
    depths = (("positive", "down"),)
    raster, _ = raster_of(write_netcdf(tmp_path / "a.nc", heights(), *DEGREES, units=units, attributes=depths))
    assert raster.georeference.crs == "EPSG:4326" and raster.has_unit
    assert "WGS 84 was taken" in raster.warnings[0] and "they are depths" in raster.warnings[1]


def test_a_terragen_field_has_scaled_heights_and_no_system(tmp_path):
    values = np.arange(35).reshape(5, 7) * 100 - 500
    raster, rows = raster_of(write_terragen(tmp_path / "a.ter", values, 10.0, 200, 40))
    assert np.allclose(rows, 10.0 * (40 + values * 200 / 65536), rtol=1e-12)
    assert not raster.georeference.first_row_south and raster.georeference.crs == ""
    assert (raster.georeference.step_x, raster.georeference.step_y) == (10.0, 10.0)


@pytest.mark.parametrize("separator,header,south_first", [(" ", "", True), (",", "X,Y,Z", False), ("\t", "", True)])
def test_dialects_of_xyz_give_the_same_heights(tmp_path, separator, header, south_first):
    wanted = heights() + 0.25
    source = write_xyz(tmp_path / "a.xyz", wanted, *METRES, separator, header, south_first)
    field, report = imported(tmp_path, source)
    assert report["filled"] == 1 and report["step_m"] == [30.0, 30.0]
    found = field.heights(slice(None), slice(None))[::-1]
    assert np.array_equal(found[~np.isnan(wanted)], wanted[~np.isnan(wanted)])


def test_a_large_text_is_refused_before_it_is_read(tmp_path):
    with (tmp_path / "a.xyz").open("wb") as file:
        file.truncate((1 << 29) + 1)
    with pytest.raises(TerrainError, match="537 MB of text; expected 537 MB at most .*gdal_translate"):
        open_source(ImportSettings(str(tmp_path / "a.xyz")))


def test_files_with_one_suffix_are_told_apart(tmp_path):
    """A .grd is Surfer's or GMT's by its first bytes; a .dem is of the USGS if it is text, else GTOPO30."""
    drivers = []
    for name in ("gmt.grd", "surfer6.grd", "surfer7.grd", "text.grd", "a.dem"):
        write, place, _ = WRITERS[name]
        drivers.append(format_choice.format_of(write(tmp_path / name, heights(), *place)).driver)
    (tmp_path / "b.dem").write_bytes(np.full(900, 513, ">i2").tobytes())
    drivers.append(format_choice.format_of(tmp_path / "b.dem").driver)
    assert drivers == ["netCDF", "GSBG", "GS7BG", "GSAG", "USGSDEM", "EHdr"]


def test_an_image_that_names_another_folder_is_refused(tmp_path):
    """An Erdas file whose samples are in a second file is read, unless that is in another folder."""
    (tmp_path / "in").mkdir()
    source = through_gdal("HFA", METRES, USE_SPILL="YES")(tmp_path / "in" / "a.img", heights(), *METRES)
    _, rows = raster_of(source)
    assert np.array_equal(rows, heights(), equal_nan=True)
    (tmp_path / "in" / "a.ige").rename(tmp_path / "bc")
    source.write_bytes(source.read_bytes().replace(b"a.ige\0", b"../bc\0"))
    with pytest.raises(TerrainError, match="names the file .*bc.; expected its parts in its own"):
        open_source(ImportSettings(str(source)))


def test_lossy_jpeg_2000_is_reported(tmp_path):
    source = through_gdal("JP2OpenJPEG", METRES)(tmp_path / "a.jp2", heights(), *METRES)
    assert "JPEG2000" in " ".join(imported(tmp_path, source)[1]["warnings"])
    source = WRITERS["a.jp2"][0](tmp_path / "b.jp2", heights(), *METRES)
    assert "JPEG2000" not in " ".join(imported(tmp_path, source)[1]["warnings"])


def test_large_parsers_need_a_complete_sandbox(tmp_path, monkeypatch):
    large = {suffix for suffix, form in source_formats.FORMATS.items() if form.is_large}
    assert large == {".nc", ".grd", ".grb", ".grb2", ".jp2"}
    rights = dict.fromkeys(("network", "programs", "processes"), "dropped") | {"writes": "kept: no Landlock"}
    monkeypatch.setattr(guard, "keep_only_drivers", lambda drivers: None)
    monkeypatch.setattr(guard.sandbox, "enter", lambda folder: rights)
    monkeypatch.setattr(guard.sandbox, "limit_memory", lambda size: "")
    for suffix in large:
        with pytest.raises(TerrainError, match="runs only in a process without any rights .writes kept: no Landlock"):
            guard.guard([tmp_path / f"a{suffix}"], None)
    guard.guard([tmp_path / "a.img"], None)
    write_surfer6(tmp_path / "a.grd", heights(), *METRES)
    guard.guard([tmp_path / "a.grd"], None)  # Surfer's parser is small


def test_a_damaged_netcdf_header_is_found_at_once(tmp_path):
    """A file without a grid is one error, and so is a header that the library would read for minutes."""
    (tmp_path / "a.nc").write_bytes(b"CDF\1" + bytes(28))
    content = write_netcdf(tmp_path / "b.nc", heights(), *METRES).read_bytes()
    (tmp_path / "b.nc").write_bytes(content[:0x70] + bytes(1000) + content[0x70:])
    (tmp_path / "c.nc").write_bytes(content[:200])
    for name, said in (
        ("a.nc", "a.nc has 0 bands|a.nc cannot be read"),
        ("b.nc", "is damaged"),
        ("c.nc", "is damaged"),
    ):
        with pytest.raises(TerrainError, match=said):
            open_source(ImportSettings(str(tmp_path / name)))


@pytest.mark.parametrize("name,write", [("a.xyz", write_xyz), ("a.sdat", write_saga), ("a.grd", write_surfer6)])
def test_a_prj_beside_a_grid_names_its_system(tmp_path, name, write):
    place = write_raster(tmp_path / "place.tif", heights(), crs="EPSG:32632", transform=(30, 0, 5e5, 0, -30, 4e6))
    with rasterio.open(place) as dataset:
        (tmp_path / "a.prj").write_text(dataset.crs.to_wkt())
    raster, _ = raster_of(write(tmp_path / name, heights(), *METRES))
    assert raster.georeference.crs == "EPSG:32632"


def test_a_changed_header_of_a_saga_grid_is_imported_again(tmp_path):
    source = write_saga(tmp_path / "a.sdat", heights(), *METRES)
    before = source_digest(ImportSettings(str(source)))
    write_saga(tmp_path / "a.sdat", heights(), *METRES, factor=0.25)
    os.utime(source, ns=(1, 1))
    changed = source_digest(ImportSettings(str(source)))
    (tmp_path / "a.sgrd").write_text((tmp_path / "a.sgrd").read_text().replace("0.25", "0.5"))
    assert len({before, changed, source_digest(ImportSettings(str(source)))}) == 3
