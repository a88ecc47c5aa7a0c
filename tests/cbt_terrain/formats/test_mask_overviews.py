# SPDX-License-Identifier: GPL-3.0-or-later
"""Overviews without a mask of a masked GeoTIFF: each of their samples that stands for a masked one is missing."""

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.formats.gdal_files import start_gdal
from adaptive_terrain.cbt_terrain.formats.gdal_source import open_overview
from adaptive_terrain.cbt_terrain.importing import thinning
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.enums import Resampling
from rasters import imported, write_raster

WIDTH, HEIGHT, MASKED = 101, 77, -7777
SMALL_WIDTH, SMALL_HEIGHT = 26, 20  # of the overview with one sample for 4 x 4


def write_masked(path, steps, dtype=np.int16, is_internal=True, has_ovr=False, has_no_data=False):
    """Write a raster of one value, MASKED where its mask hides it; `steps` gives the order of overviews and mask."""
    hidden = np.zeros((HEIGHT, WIDTH), bool)
    hidden[:, 61:], hidden[5:9, 7], hidden[-1, 30] = True, True, True
    write_raster(path, np.where(hidden, MASKED, 500).astype(dtype), nodata=MASKED if has_no_data else None)
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=is_internal, TIFF_USE_OVR=has_ovr):
        for step in steps:
            with rasterio.open(path, "r+") as file:
                if step == "mask":
                    file.write_mask(np.where(hidden, 0, 255).astype(np.uint8))
                else:
                    file.build_overviews([2, 4, 8], Resampling.average)
    assert is_internal != path.with_suffix(".tif.msk").exists() and has_ovr == path.with_suffix(".tif.ovr").exists()
    return hidden


def any_hidden(hidden):
    """Return which samples of the overview are made of a hidden one, by way of the overview of 39 x 51 samples."""
    for rows, columns in ((39, 51), (SMALL_HEIGHT, SMALL_WIDTH)):
        down, across = rows / len(hidden), columns / hidden.shape[1]
        small = np.zeros((rows, columns), bool)
        for row, column in np.argwhere(hidden):
            touched = slice(int(row * down), int(np.ceil((row + 1) * down)))
            small[touched, int(column * across) : int(np.ceil((column + 1) * across))] = True
        hidden = small
    return hidden


@pytest.mark.parametrize("is_internal", [True, False])
@pytest.mark.parametrize("has_ovr", [False, True])
@pytest.mark.parametrize("dtype", [np.int16, np.float32, np.int32])
def test_overviews_without_a_mask_hide_masked_samples(tmp_path, is_internal, has_ovr, dtype):
    path = tmp_path / "a.tif"
    hidden = any_hidden(write_masked(path, ("overviews", "mask"), dtype, is_internal, has_ovr))
    start_gdal()
    small = open_overview(path, ImportSettings(str(path)), WIDTH, np.dtype(dtype).name, 4)
    values = small.read(0, SMALL_HEIGHT)
    assert values.dtype == (np.float64 if dtype == np.int32 else np.float32)
    assert np.array_equal(values, np.where(hidden, np.nan, 500.0), equal_nan=True)
    assert np.array_equal(small.window(2, 3, 1, 20), values[2:5, 1:21], equal_nan=True)
    small.close()
    given = ImportSettings(str(path), no_data=-1.0)  # replaces the mask
    small = open_overview(path, given, WIDTH, np.dtype(dtype).name, 4)
    assert not np.isnan(small.read(0, SMALL_HEIGHT)).any() and small.read(0, SMALL_HEIGHT).min() == MASKED
    small.close()


def test_overviews_with_a_mask_are_read_as_they_are(tmp_path):
    path = tmp_path / "a.tif"
    hidden = write_masked(path, ("mask", "overviews"), has_no_data=True)
    with rasterio.open(path, OVERVIEW_LEVEL=1) as file:
        expected = np.where(file.read_masks(1) == 0, np.nan, file.read(1))
    start_gdal()
    small = open_overview(path, ImportSettings(str(path)), WIDTH, "int16", 4)
    assert np.array_equal(small.read(0, SMALL_HEIGHT), expected, equal_nan=True)
    assert 0 < np.isnan(expected).sum() < any_hidden(hidden).sum(), "GDAL keeps samples that are partly valid"
    small.close()


def test_a_quick_import_of_overviews_sees_a_late_mask(tmp_path, monkeypatch):
    monkeypatch.setattr(thinning, "MAX_UNPACKED", 1)
    monkeypatch.setattr(thinning, "FINER", 4)
    write_masked(tmp_path / "a.tif", ("overviews", "mask"))
    _, report = imported(tmp_path, tmp_path / "a.tif", quick=40, extent=(1000.0, 760.0))
    heights = open_store(tmp_path / "store").heights()
    assert report["loaded_from"] == "overviews" and heights.shape == (4, 5)
    assert report["filled"] == 10, "columns 75 and 100, and two means with a masked sample"
    assert (heights == 500.0).all()
