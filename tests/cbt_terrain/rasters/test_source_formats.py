# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of height map formats."""

import pytest
from adaptive_terrain.cbt_terrain.rasters import source_formats
from adaptive_terrain.cbt_terrain.rasters.source_formats import (
    BAND,
    CELL,
    CHANNEL,
    ENCODING,
    FORMATS,
    RAW,
    drivers_of,
    suffixes_with,
)

GDAL = ".tif .tiff .hgt .png .asc .vrt .bil .bip .bsq .flt .dem .img .dt0 .dt1 .dt2 .nc .grd .grb .grb2 .jp2".split()
GDAL += ".webp .xyz .bt .ter .sdat".split()
TABLE = [*GDAL, *".exr .npy .raw .r16 .r32 .bin .las .laz .zip .gz".split()]


def test_options_and_drivers_belong_to_the_right_suffixes():
    assert list(FORMATS) == TABLE
    assert suffixes_with(RAW) == (".raw", ".r16", ".r32", ".bin") and suffixes_with(CHANNEL) == (".exr",)
    assert [suffix for suffix, form in FORMATS.items() if form.driver] == [*GDAL, ".las", ".laz"]
    assert suffixes_with(BAND) == (*GDAL, ".las", ".laz", ".zip", ".gz") and suffixes_with(CELL) == (".las", ".laz")
    assert suffixes_with(ENCODING) == (".tif", ".tiff", ".png", ".jp2", ".webp", ".zip", ".gz")
    assert [suffix for suffix, form in FORMATS.items() if form.is_raw_alone] == [".bil", ".bip", ".bsq", ".flt"]
    assert [suffix for suffix, form in FORMATS.items() if form.has_header] == GDAL[6:11]


def test_a_file_needs_its_driver_and_a_mosaic_several():
    assert drivers_of(FORMATS[".grd"]) == {"GTiff", "netCDF"} and drivers_of(FORMATS[".npy"]) == set()
    assert drivers_of(FORMATS[".vrt"]) == {"AAIGrid", "GTiff", "PNG", "SRTMHGT", "VRT"}


@pytest.mark.parametrize("suffix", TABLE)
def test_every_format_has_a_function_that_opens_it(suffix):
    form = FORMATS[suffix]
    module, name = form.opener.split(":")
    assert name.startswith("open_") and (form.library or form.load().__name__ == name)
    assert module in ("gdal_source", "exr_source", "sources", "archives", "point_cloud")


def test_a_new_format_needs_an_entry_only(tmp_path, monkeypatch):
    """A second suffix of numpy's arrays is read, and offered everywhere."""
    import numpy as np
    from adaptive_terrain.cbt_terrain.formats.sources import open_source
    from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings

    monkeypatch.setitem(source_formats.FORMATS, ".array", FORMATS[".npy"])
    np.save(tmp_path / "a.npy", np.arange(12.0).reshape(3, 4))
    (tmp_path / "a.npy").rename(tmp_path / "a.array")
    raster = open_source(ImportSettings(str(tmp_path / "a.array")))
    assert (raster.width, raster.height, raster.read(1, 1).tolist()) == (4, 3, [[4.0, 5.0, 6.0, 7.0]])
