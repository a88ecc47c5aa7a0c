# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw samples with an ESRI header beside them, and those whose header is missing."""

import os

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.crs import CRS
from rasters import hills, imported

HEADER = """BYTEORDER {order}
LAYOUT BIL
NROWS {rows}
NCOLS {columns}
NBANDS 1
NBITS 16
PIXELTYPE SIGNEDINT
NODATA -9999
ULXMAP 7.0
ULYMAP 46.0
XDIM 0.001
YDIM 0.002
"""
GRID_FLOAT = "ncols {columns}\nnrows {rows}\nxllcorner 500000\nyllcorner 4000000\ncellsize 10\nNODATA_value -9999\n"


def write_header_file(path, heights, header=HEADER, crs="EPSG:4326", order="<"):
    """Write a file of `heights` with its header and .prj."""
    heights.astype(heights.dtype.newbyteorder(order)).tofile(path)
    rows, columns = heights.shape
    text = header.format(rows=rows, columns=columns, order="I" if order == "<" else "M")
    path.with_suffix(".hdr").write_text(text)
    path.with_suffix(".prj").write_text(CRS.from_user_input(crs).to_wkt())
    return path


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("suffix", [".bil", ".BSQ", ".bip", ".dem"])
def test_headers_say_what_samples_are(tmp_path, suffix, order):
    heights = hills().astype(np.int16)
    heights[2, 3:5] = -9999
    field, report = imported(tmp_path, write_header_file(tmp_path / f"a{suffix}", heights, order=order))
    valid = heights[::-1] != -9999
    assert np.array_equal(field.heights()[valid], heights[::-1][valid].astype(np.float32))
    assert (report["format"], report["filled"], report["raster"], field.crs) == ("EHdr", 2, [40, 30], "EPSG:4326")
    assert field.origin[:2] == pytest.approx([7.0 + 39 * 0.001 / 2, 46.0 - 29 * 0.002 / 2])


def test_grid_float(tmp_path):
    heights = hills()
    heights[0, 0] = -9999.0
    source = write_header_file(tmp_path / "a.flt", heights, GRID_FLOAT + "byteorder LSBFIRST\n", "EPSG:32616")
    field, report = imported(tmp_path, source)
    assert np.array_equal(field.heights()[:-1], heights[::-1][:-1]) and report["filled"] == 1
    assert report["step_m"] == [10.0, 10.0] and list(field.origin[:2]) == [500_200.0, 4_000_150.0]
    assert report["warnings"] == []


@pytest.mark.thorough
def test_the_child_process_reads_them_and_reprojects(tmp_path):
    source = write_header_file(tmp_path / "a.bil", hills().astype(np.int16))
    assert import_source(ImportSettings(str(source)), tmp_path / "s")["crs"] == "EPSG:4326"
    report = import_source(ImportSettings(str(source), project="utm", holes=True), tmp_path / "s")
    assert report["crs"] == "EPSG:32632" and 300 < report["highest_m"] < 900


def test_without_a_header_samples_are_raw_with_a_warning(tmp_path):
    heights = hills().astype("<u2")
    heights.tofile(tmp_path / "a.bil")
    field, report = imported(tmp_path, tmp_path / "a.bil", raw_size=(40, 30), extent=(3900.0, 2900.0))
    assert np.array_equal(field.heights(), heights[::-1]) and "no header a.hdr beside" in report["warnings"][0]
    with pytest.raises(TerrainError, match="--raw-type.*, or put its header a.hdr beside it"):
        imported(tmp_path, tmp_path / "a.bil")
    with pytest.raises(TerrainError, match="no header beside it, so no coordinate system, and cannot be reprojected"):
        imported(tmp_path, tmp_path / "a.bil", raw_size=(40, 30), project="utm")
    os.rename(tmp_path / "a.bil", tmp_path / "a.dem")
    with pytest.raises(TerrainError, match="a.dem has no header a.hdr beside it"):
        imported(tmp_path, tmp_path / "a.dem")


def test_files_that_differ_from_their_header_are_refused(tmp_path):
    source = write_header_file(tmp_path / "a.bil", hills().astype(np.int16))
    source.write_bytes(source.read_bytes()[:-100])
    with pytest.raises(TerrainError, match="has 2,300 bytes.*; expected 2,400 bytes by its header"):
        imported(tmp_path, source)
    source.with_suffix(".hdr").write_text("ENVI\nsamples = 40\nlines = 30\nbands = 1\ndata type = 2\n")
    with pytest.raises(TerrainError, match="has an ENVI header; expected an ESRI header"):
        imported(tmp_path, source)


def test_what_lies_beside_must_be_files(tmp_path):
    source = write_header_file(tmp_path / "a.bil", hills().astype(np.int16))
    os.mkfifo(tmp_path / "a.clr")
    with pytest.raises(TerrainError, match="a.clr, beside a.bil, is a pipe, a socket or a device"):
        imported(tmp_path, source)


def test_mosaics_name_none_of_them(tmp_path):
    write_header_file(tmp_path / "a.bil", hills().astype(np.int16))
    (tmp_path / "a.vrt").write_text(
        '<VRTDataset rasterXSize="40" rasterYSize="30"><VRTRasterBand dataType="Int16" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">a.bil</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>'
    )
    with pytest.raises(TerrainError, match="names the source 'a.bil'; expected one of .asc, .hgt"):
        imported(tmp_path, tmp_path / "a.vrt")


def test_bytes_in_the_other_order_warn(tmp_path):
    hills(33, 33).astype(">u2").tofile(tmp_path / "a.r16")
    size = {"extent": (32_000.0, 32_000.0), "height_scale": 1.0}
    report = imported(tmp_path, tmp_path / "a.r16", **size)[1]
    assert "if the file is big-endian" in report["warnings"][0]
    assert imported(tmp_path, tmp_path / "a.r16", raw_little_endian=False, **size)[1]["warnings"] == []
