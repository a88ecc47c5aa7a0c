# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of images without a unit: from 0 to a quarter of the width, or from the lowest to the highest given."""

import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasters import imported, write_raster

GREYS = np.linspace(1000, 61000, 40 * 30).reshape(30, 40)
PLACED = {"crs": "EPSG:32632", "transform": (10.0, 0.0, 6e5, 0.0, -10.0, 5e6)}


def image(path, name):
    """Write GREYS as 16-bit PNG, TIFF or RAW, or 8-bit PNG."""
    values = (GREYS / 256).astype(np.uint8) if name == "8.png" else GREYS.astype(np.uint16)
    if name.endswith(".r16"):
        values.tofile(path / name)
        return path / name, {"raw_size": (40, 30)}
    return write_raster(path / name, values), {}


@pytest.mark.parametrize("name", ["16.png", "8.png", "a.tif", "a.r16"])
def test_the_relief_of_an_image_is_a_quarter_of_its_width(tmp_path, name):
    file, options = image(tmp_path, name)
    field, report = imported(tmp_path, file, **options)
    assert (report["lowest_m"], report["highest_m"]) == pytest.approx((0.0, 39.0 / 4), abs=1e-5)
    heights = field.heights()[::-1].astype(np.float64)
    np.testing.assert_allclose(heights, (GREYS - 1000) / 60000 * 39.0 / 4, atol=0.05 if name == "8.png" else 1e-3)
    assert any("a quarter of the width" in warning for warning in report["warnings"])


def test_the_default_follows_the_given_width(tmp_path):
    file, _ = image(tmp_path, "16.png")
    assert imported(tmp_path, file, extent=(8000.0, 6000.0))[1]["highest_m"] == pytest.approx(2000.0)


@pytest.mark.parametrize("name", ["16.png", "8.png", "a.tif", "a.r16"])
def test_lowest_and_highest_are_the_ends(tmp_path, name):
    file, options = image(tmp_path, name)
    _, report = imported(tmp_path, file, lowest=310.0, highest=1240.0, **options)
    assert (report["lowest_m"], report["highest_m"]) == pytest.approx((310.0, 1240.0), abs=1e-3)
    assert not any("quarter" in warning for warning in report["warnings"])
    assert report["source_step_m"] == pytest.approx(
        0.5 * 930.0 / np.ptp(GREYS if name != "8.png" else GREYS // 256), rel=0.02
    )


def test_one_end_alone_keeps_the_default_relief(tmp_path):
    file, _ = image(tmp_path, "16.png")
    report = imported(tmp_path, file, lowest=500.0)[1]
    assert (report["lowest_m"], report["highest_m"]) == pytest.approx((500.0, 509.75), abs=1e-4)


def test_a_highest_height_alone_is_above_zero(tmp_path):
    file, _ = image(tmp_path, "16.png")
    with pytest.raises(TerrainError, match="lowest height, 0 m, is not below -500 m"):
        imported(tmp_path, file, highest=-500.0)
    assert imported(tmp_path, file, highest=-500.0, lowest=-600.0)[1]["highest_m"] == pytest.approx(-500.0)


@pytest.mark.parametrize("scale", [{"height_scale": 1.0}, {"height_scale": 0.5}, {"height_offset": 7.0}])
def test_an_explicit_scale_counts(tmp_path, scale):
    file, _ = image(tmp_path, "16.png")
    report = imported(tmp_path, file, **scale)[1]
    first = 1000 * scale.get("height_scale", 1.0) + scale.get("height_offset", 0.0)
    assert report["lowest_m"] == pytest.approx(first)


def test_files_with_a_place_or_signed_values_keep_metres(tmp_path):
    placed = write_raster(tmp_path / "placed.tif", GREYS.astype(np.uint16), **PLACED)
    signed = write_raster(tmp_path / "signed.tif", (GREYS / 4).astype(np.int16))
    floats = write_raster(tmp_path / "floats.tif", GREYS.astype(np.float32))
    for file, highest in ((placed, 61000.0), (signed, 15250.0), (floats, 61000.0)):
        assert imported(tmp_path, file)[1]["highest_m"] == highest


def test_heights_of_depths_keep_the_right_way_up(tmp_path):
    """A file whose own scale is negative: its largest value is the lowest ground."""
    file = write_raster(tmp_path / "a.tif", GREYS.astype(np.uint16))
    import rasterio

    with rasterio.open(file, "r+") as raster:
        raster.scales, raster.offsets = (-0.01,), (5.0,)
    field, report = imported(tmp_path, file, lowest=-50.0, highest=0.0)
    assert (report["lowest_m"], report["highest_m"]) == pytest.approx((-50.0, 0.0), abs=1e-4)
    assert field.heights()[-1, 0] == pytest.approx(0.0, abs=1e-4), "the smallest value is the highest ground"


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_flat_image_has_the_lowest_height(tmp_path, dtype):
    file = write_raster(tmp_path / "a.png", np.full((30, 40), 9, dtype))
    assert imported(tmp_path, file, lowest=3.0, highest=4.0)[1]["lowest_m"] == pytest.approx(3.0)
    report = imported(tmp_path, file)[1]
    assert report["lowest_m"] == report["highest_m"] == 0.0
    assert "All values of a.png are 9 and have no unit: the terrain is flat, at 0 m." in report["warnings"]
    assert not any("quarter" in warning for warning in report["warnings"])


@pytest.mark.parametrize(
    "bad",
    [{"lowest": 2.0, "highest": 1.0}, {"lowest": float("nan")}, {"lowest": 0.0, "height_scale": 2.0}],
)
def test_contradicting_heights_are_refused(bad):
    with pytest.raises(TerrainError, match="height"):
        ImportSettings("a.png", **bad).check()


def test_ends_of_a_file_without_a_scale_are_flat(tmp_path):
    import rasterio

    source = write_raster(tmp_path / "a.tif", GREYS.astype(np.uint16), **PLACED)
    with rasterio.open(source, "r+") as file:
        file.scales, file.offsets = (0.0,), (7.0,)
    _, report = imported(tmp_path, source, lowest=310.0, highest=1240.0)
    assert (report["lowest_m"], report["highest_m"]) == (310.0, 310.0)


@pytest.mark.parametrize("scale, offset", [(np.nan, 0.0), (np.inf, 0.0), (1.0, np.nan), (1.0, -np.inf)])
def test_a_scale_that_is_no_number_is_refused(tmp_path, scale, offset):
    import rasterio

    source = write_raster(tmp_path / "a.tif", GREYS.astype(np.uint16), **PLACED)
    with rasterio.open(source, "r+") as file:
        file.scales, file.offsets = (scale,), (offset,)
    with pytest.raises(TerrainError, match="a.tif gives its values the scale"):
        imported(tmp_path, source)
    with pytest.raises(TerrainError, match="a.tif gives its values the scale"):  # of a mosaic of two equal files
        open_composite(ImportSettings(str(source), more_sources=(str(shutil.copy(source, tmp_path / "b.tif")),)), None)
