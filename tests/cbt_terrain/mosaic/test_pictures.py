# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos beside height maps: they are left out of a folder or a pattern, but not if the user names them."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_info import describe_sources
from mosaic_files import EAST, NORTH, UTM32, settings_of, sheet
from rasterio.transform import from_origin


def write_picture(path: Path, bands=3, kind="uint8", colors=None, **options) -> Path:
    """Write a GeoTIFF of colors, 60 x 60 samples of a metre, over the same ground as `heights`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = np.random.default_rng(5).integers(0, 256, (bands, 60, 60)) if colors is None else colors
    options = {"crs": UTM32, "transform": from_origin(EAST, NORTH, 1.0, 1.0)} | options
    shape = {"count": len(values), "height": 60, "width": 60, "dtype": kind}
    with rasterio.open(path, "w", **shape, **options) as file:
        file.write(values.astype(kind))
    return path


def heights(path: Path, shift=0.0) -> Path:
    """Write heights of 60 x 60 m with a step of 2 m."""
    sheet(UTM32, EAST, NORTH, 2.0, 2.0, 30, 30, shift).write(path)
    return path


def describe(*sources, **settings) -> tuple[dict, list[str]]:
    """Return the report on sources, and its notes on pictures that are left out."""
    report = describe_sources(settings_of(*sources, **settings))
    return report, [text for text in report["warnings"] if "left out" in text]


@pytest.mark.parametrize("source", ["", "*.tif"])
def test_photos_beside_heights_are_left_out(tmp_path, source):
    heights(tmp_path / "b.tif")
    for number, bands in enumerate((3, 4, 3, 4)):
        write_picture(tmp_path / f"photo_{number}.tif", bands)
    report, [note] = describe(tmp_path / source if source else tmp_path)
    assert (report["files"], report["raster"], report["seams"]) == (1, [30, 30], 0)
    assert "photo_0.tif, photo_1.tif, photo_2.tif and 1 more." in note and "--encoding" in note
    assert not any("bands; band 1" in text for text in report["warnings"])
    imported = run_mosaic_import(settings_of(tmp_path), tmp_path / "store")
    assert note in imported["warnings"] and imported["files"] == 1
    assert run_mosaic_import(settings_of(tmp_path), tmp_path / "store").get("unchanged")


def test_photos_without_a_position_are_left_out(tmp_path):
    photo = write_picture(tmp_path / "photo.tif", transform=rasterio.Affine.identity(), crs=None)
    with pytest.raises(TerrainError, match=r"photo.tif cannot be a part of a mosaic \(it has no position\)"):
        describe(tmp_path)
    heights(tmp_path / "b.tif")
    report, [note] = describe(tmp_path)
    assert report["files"] == 1 and "photo.tif" in note
    with pytest.raises(TerrainError, match="photo.tif cannot be a part of a mosaic"):
        describe(tmp_path, photo)


def test_pictures_that_the_user_chooses_hold_heights(tmp_path):
    """By their names, their encoding or their band; and other files than those of 8 bits, or without heights."""
    photo, wide = write_picture(tmp_path / "a" / "photo.tif"), write_picture(tmp_path / "b" / "wide.tif", kind="uint16")
    assert describe(tmp_path / "a")[1] == [], "there is nothing else"
    for folder in (photo.parent, wide.parent):
        heights(folder / "h.tif")
    for sources, settings in (
        ([photo.parent, photo], {}),
        ([photo.parent / "h.tif", photo], {}),
        ([photo.parent], {"encoding": "plain"}),
        ([wide.parent], {}),
    ):
        report, notes = describe(*sources, **settings)
        assert report["files"] == 2 and notes == []


def test_heights_that_are_coded_in_colours_are_read(tmp_path):
    """Terrarium's codes: a height is red * 256 + green + blue / 256 - 32768."""
    codes = np.round((np.add.outer(np.arange(60.0), np.arange(60.0)) + 500.0 + 32768.0) * 256.0).astype(np.int64)
    write_picture(tmp_path / "a.tif", colors=np.stack([codes >> 16, codes >> 8 & 255, codes & 255]))
    place = from_origin(EAST + 60.0, NORTH, 1.0, 1.0)
    write_picture(tmp_path / "b.tif", colors=np.stack([codes >> 16, codes >> 8 & 255, codes & 255]), transform=place)
    report = run_mosaic_import(settings_of(tmp_path, encoding="terrarium"), tmp_path / "store")
    assert report["files"] == 2 and not any("left out" in text for text in report["warnings"])
    assert (report["lowest_m"], report["highest_m"]) == pytest.approx((500.0, 618.0), abs=0.01)


def test_pictures_of_an_earlier_import_are_left_out(tmp_path):
    """The store's catalogue has them as heights; then a height map is put beside them."""
    write_picture(tmp_path / "maps" / "photo.tif")
    settings, store = settings_of(tmp_path / "maps"), tmp_path / "store"
    assert run_mosaic_import(settings, store)["files"] == 1
    heights(tmp_path / "maps" / "h.tif")
    report = run_mosaic_import(settings, store)
    assert report["files"] == 1 and report["raster"] == [30, 30]
