# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about bands that may not hold heights, masks, and errors about files that GDAL refuses."""

import warnings

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from rasterio.enums import ColorInterp
from rasters import hills, imported, write_raster

SIZE = {"extent": (3900.0, 2900.0)}


def write_bands(path, *bands, **options):
    shape = {"height": 30, "width": 40, "count": len(bands), "dtype": bands[0].dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", **(shape | options)) as file:
            for number, band in enumerate(bands, 1):
                file.write(band, number)
    return path


def test_another_band_is_named_as_a_choice(tmp_path):
    source = write_bands(tmp_path / "a.tif", hills(), hills() + 1000.0)
    (warning,) = imported(tmp_path, source, **SIZE)[1]["warnings"]
    assert warning.startswith("The file has 2 bands; band 1 is taken") and "(--band)" in warning
    field, report = imported(tmp_path, source, band=2, **SIZE)
    assert field.min_height > 1000.0 and report["warnings"] == []


def test_colours_that_may_hold_packed_heights_warn(tmp_path):
    colours = [np.full((30, 40), value, np.uint8) for value in (1, 134, 160)]
    assert "8 bits" in imported(tmp_path, write_bands(tmp_path / "a.tif", *colours), band=2, **SIZE)[1]["warnings"][0]
    for name in ("a.png", "a.tif"):
        warning = imported(tmp_path, write_bands(tmp_path / name, *colours), **SIZE)[1]["warnings"][0]
        assert "coded in its colours" in warning and "--encoding terrarium or mapbox" in warning
        report = imported(tmp_path, tmp_path / name, encoding="mapbox", **SIZE)[1]  # sea level
        assert (report["lowest_m"], report["highest_m"]) == (0.0, 0.0) and "coded" not in " ".join(report["warnings"])


@pytest.mark.parametrize("kind", ["float32", "uint16"])
@pytest.mark.parametrize("most", [1, 255])
def test_alpha_bands_mask_samples(tmp_path, kind, most):
    alpha = np.full((30, 40), most, kind)
    alpha[4:7, 8:12] = 0
    source = write_bands(tmp_path / "a.tif", hills().astype(kind), alpha, ALPHA="YES")
    with rasterio.open(source) as file:
        assert file.colorinterp[1] == ColorInterp.alpha
    field, report = imported(tmp_path, source, height_scale=1.0, **SIZE)
    assert report["filled"] == 12 and report["warnings"] == []
    seen = np.ones((30, 40), bool)
    seen[4:7, 8:12] = False
    assert np.array_equal(field.heights()[::-1][seen], hills().astype(kind)[seen].astype(np.float32))


def test_a_mask_file_counts_after_a_mosaic(tmp_path):
    """Both run in one process, and a mosaic forbids GDAL to look for neighbouring files of its sources."""
    write_raster(tmp_path / "a.tif", hills())
    (tmp_path / "a.vrt").write_text(
        '<VRTDataset rasterXSize="40" rasterYSize="30"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">a.tif</SourceFilename></SimpleSource></VRTRasterBand></VRTDataset>'
    )
    imported(tmp_path, tmp_path / "a.vrt", **SIZE)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(tmp_path / "a.tif", "r+") as file:
        file.write_mask(np.where(hills() > 300.0, 255, 0).astype(np.uint8))
    assert (tmp_path / "a.tif.msk").exists()
    assert imported(tmp_path, tmp_path / "a.tif", **SIZE)[1]["filled"] == int((hills() <= 300.0).sum())


@pytest.mark.parametrize("text", ["-3.4028235e+38", "-3.40282347e+38", "-3.4e+38", "-3.4028234663852886e+38"])
def test_no_data_near_the_largest_float_is_no_data(tmp_path, text):
    heights = hills()
    heights[:2, :3] = float(text) if float(text) > -3.4028235e38 else -3.4028234663852886e38
    write_raster(tmp_path / "a.tif", heights)
    (tmp_path / "a.vrt").write_text(
        f'<VRTDataset rasterXSize="40" rasterYSize="30"><VRTRasterBand dataType="Float32" band="1"><NoDataValue>{text}'
        '</NoDataValue><SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename></SimpleSource>'
        "</VRTRasterBand></VRTDataset>"
    )
    assert imported(tmp_path, tmp_path / "a.vrt", **SIZE)[1]["filled"] == 6


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.tif", b"\x89PNG\r\n\x1a\n" + bytes(64), "by its content it is PNG: give it that suffix, or convert it"),
        ("a.png", b"\xff\xd8\xff\xe0" + bytes(64), "by its content it is JPEG"),
        ("a.tif", b"PK\x03\x04" + bytes(64), "by its content it is ZIP"),
        ("a.asc", b"\xef\xbb\xbfncols 2\nnrows 2\n", "save it as plain text"),
        ("a.tif", b"II*\0" + bytes(64), "expected a whole file of that kind"),
        ("N46E007.hgt", bytes(601 * 601 * 2), "1201 x 1201 or 3601 x 3601"),
        ("a.zip", b"PK\x03\x04", "cannot be unpacked (File is not a zip file)"),
        ("a.rar", b"Rar!", "unpack an archive, and convert other kinds to GeoTIFF"),
    ],
)
def test_files_of_another_kind_are_named(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TerrainError) as error:
        imported(tmp_path, tmp_path / name)
    assert said in str(error.value)


def test_complex_numbers_are_refused(tmp_path):
    for kind in ("complex64", "complex_int16"):
        source = write_bands(tmp_path / "a.tif", hills().astype(np.complex64), dtype=kind)
        with pytest.raises(TerrainError, match=f"holds {kind} values; expected real numbers"):
            imported(tmp_path, source)
