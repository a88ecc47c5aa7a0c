# SPDX-License-Identifier: GPL-3.0-or-later
"""Units of heights and of coordinate systems, against PROJ's own table."""

import os
import sqlite3

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.importing.placing import placing_of
from adaptive_terrain.cbt_terrain.rasters.units import height_unit, metres_of
from rasterio.crs import CRS
from rasterio.transform import from_origin
from rasters import hills, imported, write_raster

FT, US = 0.3048, 1200.0 / 3937.0
LOCAL = 'LOCAL_CS["site",UNIT["foot",0.3048],AXIS["East",EAST],AXIS["North",NORTH]]'
ENGINEERING = (
    'ENGCRS["local",EDATUM["site"],CS[Cartesian,2],AXIS["(E)",east],AXIS["(N)",north],'
    'LENGTHUNIT["US survey foot",0.304800609601219]]'
)


def proj_units():
    """Return names and metres of PROJ's units of length; its entry of the decimetre, 0.01, is wrong."""
    table = os.path.join(os.path.dirname(rasterio.__file__), "proj_data", "proj.db")
    columns = "name, proj_short_name, conv_factor FROM unit_of_measure WHERE type = 'length' AND deprecated = 0"
    with sqlite3.connect(table) as database:
        rows = database.execute(f"SELECT {columns} AND name NOT LIKE '% per %' AND code != 'DM'").fetchall()
    return [(name, metres) for *names, metres in rows for name in names if name]


def test_all_of_projs_units_are_known_in_any_spelling():
    units = proj_units()
    assert len(units) > 60
    for name, metres in units:
        american = name.replace("metre", "meter").replace("foot", "feet")
        plural = "s" if len(name) > 1 else ""  # "ms" are milliseconds
        for text in (name, name.upper(), name.replace(" ", "_"), name.replace(" ", "-"), f" {american}{plural} "):
            assert metres_of(text) == pytest.approx(metres, rel=3e-10), text


@pytest.mark.parametrize(
    ("names", "metres"),
    [
        (("ft", "Feet", "'", "international foot", "foot (international)", "intl ft", "Foot_International"), FT),
        (("us-ft", "us_ft", "usft", "ftUS", "ft_us", "US survey feet", "U.S. Survey Foot", "Foot_US"), US),
        (('"', "in", "Inches"), 0.0254),
        (("m", "Metres", "METER"), 1.0),
        (("Centimetre", "cm"), 0.01),
        (("um", "µm", "micrometre"), 1e-6),
        (("nautical miles", "nmi"), 1852.0),
        (("Meter_German_Legal",), 1.0000135965),
        (("furlong", "degree", "", "m asl", "unknown", "US"), None),
        (
            ("m/s", "ms", "% m", "in/s", "m/m", "m s", "in s", "m^2", "m*m", "m m", "m·m", "ft/s", "ft_s", "°", "m.s"),
            None,
        ),
        (("yds", "Yards", "yd."), 3.0 * FT),
        (("kms", "[km]"), 1e3),
        (("fts", "(ft)", "ft."), FT),
        (("ins",), 0.0254),
    ],
)
def test_names_of_gdal_and_esri(names, metres):
    for name in names:
        assert metres_of(name) == (None if metres is None else pytest.approx(metres, rel=1e-12)), name


def imported_in(tmp_path, unit, crs="EPSG:32616", **settings):
    source = write_raster(tmp_path / "a.tif", hills(), crs=crs, transform=from_origin(5e5, 4e6, 10, 10))
    with rasterio.open(source, "r+") as file:
        file.units = (unit,)
    return imported(tmp_path, source, **settings)


@pytest.mark.parametrize(("unit", "metres"), [("us-ft", US), ("Clarke's foot", 0.3047972654), ("Kilometre", 1e3)])
def test_heights_become_metres(tmp_path, unit, metres):
    field, report = imported_in(tmp_path, unit)
    assert np.allclose(field.heights(), hills()[::-1] * metres, rtol=1e-6)
    assert f"Heights are in {unit} in the file" in report["warnings"][0]


def test_an_unknown_unit_warns(tmp_path):
    field, report = imported_in(tmp_path, "cubit")
    assert np.array_equal(field.heights(), hills()[::-1])
    assert "'cubit', which is no known unit" in report["warnings"][0] and "--height-scale" in report["warnings"][0]


def test_the_vertical_axis_of_a_system_counts(tmp_path):
    for name in ("a.tif", "a.vrt"):  # a VRT's band has no unit
        source = write_raster(
            tmp_path / "a.tif", hills(), crs="EPSG:26918+6360", transform=from_origin(5e5, 4e6, 10, 10)
        )
        if name == "a.vrt":
            source = tmp_path / name
            wkt = CRS.from_user_input("EPSG:26918+6360").to_wkt()
            source.write_text(
                f'<VRTDataset rasterXSize="40" rasterYSize="30"><SRS>{wkt}</SRS><GeoTransform>5e5,10,0,4e6,0,-10'
                '</GeoTransform><VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename '
                'relativeToVRT="1">a.tif</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>'
            )
        field, report = imported(tmp_path, source)
        assert np.allclose(field.heights(), hills()[::-1] * US, rtol=1e-6)
        assert len(report["warnings"]) == 1 and "US survey foot" in report["warnings"][0]


@pytest.mark.parametrize(("unit", "metres"), [("'", FT), ("&quot;", 0.0254), ("ft (US)", US), ("°", None)])
def test_units_of_a_mosaics_band(tmp_path, unit, metres):
    write_raster(tmp_path / "a.tif", hills())
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="40" rasterYSize="30"><VRTRasterBand dataType="Float32" band="1"><UnitType>{unit}'
        '</UnitType><SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    field, report = imported(tmp_path, tmp_path / "a.vrt", extent=(3900.0, 2900.0))
    assert np.allclose(field.heights(), hills()[::-1] * (metres or 1.0), rtol=1e-6)
    assert ("no known unit" in report["warnings"][0]) == (metres is None)


def test_a_bands_unit_wins_over_its_system_and_warns(tmp_path):
    field, report = imported_in(tmp_path, "ft", "EPSG:26918+5703")
    assert np.allclose(field.heights(), hills()[::-1] * FT, rtol=1e-6)
    assert "in ft by the band's unit and in metre by the coordinate system" in report["warnings"][0]
    assert height_unit("m", CRS.from_user_input("EPSG:26918+5703")) == (1.0, [])


def test_depths_and_unnamed_units_in_feet_warn():
    metres, (warning,) = height_unit("", CRS.from_user_input("EPSG:4326+5706"))
    assert metres == 1.0 and "a height scale of -1" in warning
    metres, (warning,) = height_unit("", CRS.from_epsg(2260))
    assert metres == 1.0 and "a height scale of 0.3048006096" in warning


@pytest.mark.parametrize(("system", "metres"), [(LOCAL, FT), (ENGINEERING, US)])
def test_local_systems_have_their_unit(tmp_path, system, metres):
    source = write_raster(tmp_path / "a.tif", hills(), crs=system, transform=from_origin(1000, 2000, 10, 10))
    field, report = imported(tmp_path, source)
    assert report["step_m"] == pytest.approx([10 * metres] * 2, rel=1e-12)
    placing = placing_of(tmp_path / "store")
    assert placing.to_terrain(np.array([[1205.0, 1855.0]])) == pytest.approx(np.array([[5.0, 5.0]]) * metres)


def tile_of_a_mosaic(tmp_path, how):
    """Write a tile whose heights are not metres, and a VRT over it that does not pass this on; returns the VRT."""
    place = {"crs": "EPSG:32632+6360" if how == "vertical axis" else "EPSG:32632"}
    tile = write_raster(tmp_path / "a.tif", hills(), transform=from_origin(5e5, 5e6, 10, 10), **place)
    if how == "aux":
        band = '<PAMRasterBand band="1"><UnitType>ft</UnitType></PAMRasterBand>'
        (tmp_path / "a.tif.aux.xml").write_text(f"<PAMDataset>{band}</PAMDataset>")
    elif how != "vertical axis":
        with rasterio.open(tile, "r+") as file:
            if how == "unit":
                file.units = ("ft",)
            elif how == "metres":
                file.units = ("metre",)
            else:
                file.scales, file.offsets = (0.01,), (250.0,)
    return mosaic_over(tmp_path / "a.vrt", "a.tif")


def mosaic_over(path, name, band="", srs="EPSG:32632"):
    path.write_text(
        f'<VRTDataset rasterXSize="40" rasterYSize="30"><SRS>{srs}</SRS><GeoTransform>5e5,10,0,5e6,0,-10'
        f'</GeoTransform><VRTRasterBand dataType="Float32" band="1">{band}<SimpleSource><SourceFilename '
        f'relativeToVRT="1">{name}</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>'
    )
    return path


@pytest.mark.parametrize(
    ("how", "parts"),
    [
        ("unit", ("heights in ft", "<UnitType>ft</UnitType>", "--height-scale 0.3048.")),
        ("aux", ("heights in ft", "<UnitType>ft</UnitType>", "--height-scale 0.3048.")),
        ("vertical axis", ("heights in US survey foot", "--height-scale 0.3048006096.")),
        ("scale", ("scale of 0.01 and an offset of 250", "--height-scale 0.01 --height-offset 250.")),
    ],
)
def test_a_mosaic_warns_of_what_its_files_alone_tell(tmp_path, how, parts):
    source = tile_of_a_mosaic(tmp_path, how)
    [warning] = imported(tmp_path, source)[1]["warnings"]
    assert all(part in warning for part in parts) and "the VRT does not" in warning
    outer = mosaic_over(tmp_path / "outer.vrt", "a.vrt")
    assert imported(tmp_path, outer)[1]["warnings"] == [warning]


def test_a_mosaic_that_tells_the_same_does_not_warn(tmp_path):
    assert imported(tmp_path, tile_of_a_mosaic(tmp_path, "metres"))[1]["warnings"] == []
    tile_of_a_mosaic(tmp_path, "unit")
    [warning] = imported(tmp_path, mosaic_over(tmp_path / "b.vrt", "a.tif", "<UnitType>ft</UnitType>"))[1]["warnings"]
    assert warning == "Heights are in ft in the file; they were converted to metres."
    wkt = CRS.from_user_input("EPSG:32632+8228").to_wkt()
    [warning] = imported(tmp_path, mosaic_over(tmp_path / "b.vrt", "a.tif", srs=wkt))[1]["warnings"]
    assert warning == "Heights are in foot in the file; they were converted to metres."
    tile_of_a_mosaic(tmp_path, "scale")
    scaled = mosaic_over(tmp_path / "b.vrt", "a.tif", "<Offset>250</Offset><Scale>0.01</Scale>")
    field, report = imported(tmp_path, scaled)
    assert report["warnings"] == [] and field.max_height < 270.0


def test_files_of_a_mosaic_in_different_units_warn(tmp_path):
    source = tile_of_a_mosaic(tmp_path, "unit")
    write_raster(tmp_path / "b.tif", hills())
    text = source.read_text()
    part = text[text.index("<SimpleSource>") : text.index("</VRTRasterBand>")]
    source.write_text(text.replace(part, part + part.replace("a.tif", "b.tif")))
    [warning] = imported(tmp_path, source)[1]["warnings"]
    assert "in different ways (" in warning and "in ft" in warning and "as metres" in warning
    converted = "<ComplexSource>" + part[14:-15] + "<ScaleRatio>0.3048</ScaleRatio></ComplexSource>"
    source.write_text(text.replace(part, converted))  # the VRT itself makes them metres
    field, report = imported(tmp_path, source)
    assert report["warnings"] == [] and np.allclose(field.heights(), hills()[::-1] * FT, rtol=1e-6)
