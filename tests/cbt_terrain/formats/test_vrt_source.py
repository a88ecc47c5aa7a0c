# SPDX-License-Identifier: GPL-3.0-or-later
"""Our own reader of VRTs, where the hard cases do not reach: other computers, long numbers, what GDAL is given."""

from pathlib import PureWindowsPath
from xml.etree import ElementTree

import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.gdal_files import MOSAIC_SUFFIXES
from adaptive_terrain.cbt_terrain.formats.vrt_source import _is_local, read_mosaic
from hostile_files import PART, source, vrt
from rasters import hills, write_raster


@pytest.mark.parametrize(
    "named, vrt_at, local",
    [
        (r"\\other\share\a.tif", r"C:\maps\a.vrt", False),
        ("//other/share/a.tif", r"C:\maps\a.vrt", False),
        (r"\\other\share\a.tif", r"\\mine\share\a.vrt", False),
        (r"\\mine\share\b.tif", r"\\mine\share\a.vrt", True),
        (r"D:\maps\b.tif", r"C:\maps\a.vrt", True),
    ],
)
def test_sources_on_other_computers_are_not_asked_for(named, vrt_at, local):
    assert _is_local(PureWindowsPath(named), PureWindowsPath(vrt_at)) is local


def test_gdal_is_given_whole_paths_and_nothing_else(tmp_path):
    write_raster(tmp_path / PART, hills(65, 33))
    (tmp_path / "in.vrt").write_text(vrt(source(PART)))
    (tmp_path / "a.vrt").write_text("<!-- <x> --><?pi?>" + vrt(source("in.vrt", more="<![CDATA[ ]]>") + source(PART)))
    mosaic = read_mosaic(tmp_path / "a.vrt", MOSAIC_SUFFIXES)
    assert list(mosaic.sources) == [tmp_path / "in.vrt", tmp_path / PART] and len(mosaic.texts) == 2
    inner, outer = ([n.text for n in ElementTree.fromstring(t).iter("SourceFilename")] for t in mosaic.texts)
    assert inner == [str(tmp_path / PART)]
    assert outer == [f"/vsimem/{mosaic.folder}/0.vrt", str(tmp_path / PART)]
    assert not any('relativeToVRT="1"' in t or "<!" in t or "<?" in t for t in mosaic.texts)


def test_long_numbers_are_refused_at_once(tmp_path):
    for text in ("1" * 60_000 + "x", "1," * 30_000, "(" * 60_000):
        (tmp_path / "a.vrt").write_text(vrt("").replace("<VRTR", f"<GeoTransform>{text}</GeoTransform><VRTR"))
        with pytest.raises(TerrainError, match="for GeoTransform in <GeoTransform>"):
            read_mosaic(tmp_path / "a.vrt", MOSAIC_SUFFIXES)


def test_a_mosaic_that_is_too_large_opens_no_source(tmp_path):
    """A header of 1,200,000,000 samples a row is refused before a source, here a missing one, is looked at."""
    text = vrt(source("gone.tif")).replace('"65"', '"1200000000"')
    (tmp_path / "a.vrt").write_text(text)
    with pytest.raises(TerrainError, match=r"a.vrt has 1200000000 x 33 samples; expected at most 2\^30 in a row"):
        read_mosaic(tmp_path / "a.vrt", MOSAIC_SUFFIXES)


def test_an_image_that_is_too_large_is_refused_unread(tmp_path):
    """Heights of an image are fitted to its lowest and highest value only after its size was checked."""
    from adaptive_terrain.cbt_terrain.importing import build_store
    from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings, Raster

    def read(_first, _count):
        raise AssertionError("a row was read")

    (tmp_path / "a.png").write_bytes(b"a")
    raster = Raster(1_200_000_000, 2, read, "uint16", "PNG")
    with pytest.raises(TerrainError, match="1200000000 x 2 samples; expected at most"):
        settings, path = ImportSettings(str(tmp_path / "a.png")), tmp_path / "a.png"
        build_store.import_raster(settings, path, tmp_path / "store", "data", print, lambda _settings: raster)
