# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of height map formats."""

import pytest
from adaptive_terrain.cbt_terrain.importing import gdal_source, source_formats
from adaptive_terrain.cbt_terrain.importing.source_formats import BAND, CHANNEL, FORMATS, RAW, suffixes_with

TABLE = ".tif .tiff .hgt .png .asc .vrt .bil .bip .bsq .flt .dem .exr .npy .raw .r16 .r32 .bin".split()


def test_options_and_drivers_belong_to_the_right_suffixes():
    assert list(FORMATS) == TABLE
    assert suffixes_with(RAW) == (".raw", ".r16", ".r32", ".bin") and suffixes_with(CHANNEL) == (".exr",)
    assert suffixes_with(BAND) == tuple(gdal_source.DRIVERS) == tuple(TABLE[:11])
    assert sorted(gdal_source.MOSAIC_DRIVERS.values()) == ["AAIGrid", "GTiff", "GTiff", "PNG", "SRTMHGT", "VRT"]
    assert [suffix for suffix, form in FORMATS.items() if form.is_raw_alone] == [".bil", ".bip", ".bsq", ".flt"]
    assert [suffix for suffix, form in FORMATS.items() if form.has_header] == TABLE[6:11]


@pytest.mark.parametrize("suffix", TABLE)
def test_every_format_has_a_function_that_opens_it(suffix):
    form = FORMATS[suffix]
    module, name = form.opener.split(":")
    assert name.startswith("open_") and (form.library or form.load().__name__ == name)
    assert module in ("gdal_source", "exr_source", "sources")


def test_a_new_format_needs_an_entry_only(tmp_path, monkeypatch):
    """A second suffix of numpy's arrays is read, and offered everywhere."""
    import numpy as np
    from adaptive_terrain.cbt_terrain.importing.raster import ImportSettings
    from adaptive_terrain.cbt_terrain.importing.sources import open_source

    monkeypatch.setitem(source_formats.FORMATS, ".array", FORMATS[".npy"])
    np.save(tmp_path / "a.npy", np.arange(12.0).reshape(3, 4))
    (tmp_path / "a.npy").rename(tmp_path / "a.array")
    raster = open_source(ImportSettings(str(tmp_path / "a.array")))
    assert (raster.width, raster.height, raster.read(1, 1).tolist()) == (4, 3, [[4.0, 5.0, 6.0, 7.0]])
