# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounding of the source, which is in every bound: against the samples before they were rounded."""

import numpy as np
import OpenEXR
import pytest
from adaptive_terrain.cbt_terrain.rasters.rounding import SourceRounding
from rasters import hills, imported, write_raster

SIZE = {"extent": (39_000.0, 29_000.0)}


def write_packed(path, heights, compression, name="Z"):
    OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, {name: heights}).write(str(path))
    return path


@pytest.mark.parametrize("kind", ["float16", "float32", "float64"])
def test_half_steps_are_numpys(kind):
    values = np.random.default_rng(1).uniform(0.0, 65000.0, 500).astype(kind)
    values[:4] = 0.0, 1.0, 2.0, np.finfo(kind).tiny / 4
    for value in values:
        assert SourceRounding(kind).half_step(float(value)) == 0.5 * float(np.spacing(value))


def test_scaled_and_whole_numbers():
    assert SourceRounding("int16").scaled(-0.1, 7.0).half_step(1e5) == pytest.approx(0.05)
    assert SourceRounding("float32").scaled(0.0, 7.0).half_step(7.0) == 0.0
    assert (
        SourceRounding("float16").scaled(2.0, 100.0).half_step(100.0) == SourceRounding("float16").half_step(100.0) * 2
    )
    assert SourceRounding("float32", before=SourceRounding("int16")).half_step(1.0) == 0.5 + 2.0**-24


def test_the_largest_half_float_is_imported(tmp_path):
    heights = hills().astype(np.float16)
    heights[3, 3] = 65504
    field, report = imported(tmp_path, write_packed(tmp_path / "a.exr", heights, OpenEXR.ZIP_COMPRESSION), **SIZE)
    assert field.source_max == 16.0 and "have steps of 32 m" in report["warnings"][0]


@pytest.mark.parametrize(
    ("options", "at_least"),
    [
        ({"NBITS": 16}, 0.1),
        ({"compress": "LERC", "MAX_Z_ERROR": 0.5}, 0.25),
        ({"compress": "LERC_ZSTD", "MAX_Z_ERROR": 3}, 1.5),
    ],
)
def test_lossy_tiffs_are_within_the_bound(tmp_path, options, at_least):
    heights = hills()
    field, report = imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **options), **SIZE)
    off = np.abs(field.heights() - heights[::-1]).max()
    assert at_least < off <= field.source_max <= 4 * off
    assert bool(report["warnings"]) == ("NBITS" in options)


def test_pxr24_is_within_the_bound(tmp_path):
    heights = hills()
    field, report = imported(tmp_path, write_packed(tmp_path / "a.exr", heights, OpenEXR.PXR24_COMPRESSION), **SIZE)
    off = np.abs(field.heights() - heights[::-1]).max()
    assert 0.0 < off <= field.source_max <= 2 * off and "24-bit floats" in report["warnings"][0]


@pytest.mark.parametrize(
    ("method", "kind", "name", "warns"),
    [("DWAA", "f4", "Y", True), ("DWAB", "f2", "height.R", True), ("DWAA", "f4", "Z", False), ("B44", "f2", "Z", True),
     ("B44A", "f4", "Z", False), ("PIZ", "f4", "Z", False), ("HTJ2K32", "f4", "Z", False)],
)  # fmt: skip
def test_methods_without_a_known_error_warn(tmp_path, method, kind, name, warns):
    heights = hills().astype(kind)
    source = write_packed(tmp_path / "a.exr", heights, getattr(OpenEXR, f"{method}_COMPRESSION"), name)
    field, report = imported(tmp_path, source, **SIZE)
    assert any(f"compressed with loss ({method})" in warning for warning in report["warnings"]) == warns
    assert warns or np.array_equal(field.heights(), heights[::-1].astype(np.float32))


def test_jpeg_in_a_tiff_warns(tmp_path):
    heights = (hills() / 8).astype(np.uint8)
    for options, warns in (({"compress": "JPEG"}, True), ({"compress": "DEFLATE"}, False)):
        report = imported(tmp_path, write_raster(tmp_path / "a.tif", heights, **options), **SIZE)[1]
        assert any("compressed with loss (JPEG)" in warning for warning in report["warnings"]) == warns


def mosaic(path, source, kind, scaling="", inner=""):
    """Write a VRT of 40 x 30 samples; with `inner`, the source is a VRT of the same kind."""
    path.write_text(
        f'<VRTDataset rasterXSize="40" rasterYSize="30"><VRTRasterBand dataType="{kind}" band="1"><ComplexSource>'
        f'<SourceFilename relativeToVRT="1">{source}</SourceFilename><SourceBand>1</SourceBand>{scaling}'
        "</ComplexSource></VRTRasterBand></VRTDataset>"
    )
    return path


@pytest.mark.parametrize("nested", [False, True])
def test_a_mosaic_has_the_rounding_of_its_sources(tmp_path, nested):
    """Whole numbers in a band of floats, at a tenth of a metre each."""
    exact = hills()
    write_raster(tmp_path / "a.tif", np.round(exact * 10).astype(np.int16))
    scaling = "<ScaleOffset>5</ScaleOffset><ScaleRatio>0.1</ScaleRatio>"
    source = mosaic(tmp_path / "a.vrt", "a.tif", "Float32", scaling)
    if nested:
        source = mosaic(tmp_path / "b.vrt", "a.vrt", "Float64")
    field, _ = imported(tmp_path, source, **SIZE)
    off = np.abs(field.heights() - exact[::-1] - 5).max()
    assert 0.04 < off <= field.source_max < 0.0502


def test_a_table_in_a_mosaic_and_exact_copies(tmp_path):
    write_raster(tmp_path / "a.tif", hills().astype(np.int16))
    table = "<LUT>0:0,500:50,1000:1050</LUT>"
    assert imported(tmp_path, mosaic(tmp_path / "a.vrt", "a.tif", "Float32", table), **SIZE)[0].source_max > 1.0
    write_raster(tmp_path / "b.tif", hills())
    alone = imported(tmp_path, tmp_path / "b.tif", **SIZE)[0].source_max
    assert imported(tmp_path, mosaic(tmp_path / "b.vrt", "b.tif", "Float32"), **SIZE)[0].source_max == alone
