# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights in the colours of images, and web map tiles."""

import dataclasses
import hashlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.formats.sources import open_source
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.source_info import describe_source
from adaptive_terrain.cbt_terrain.rasters.coded_heights import codes_of, may_be_coded, tile_of
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasters import imported

STEPS = {"terrarium": (1 / 256, -32768.0), "mapbox": (0.1, -10000.0)}
ZOOM, COLUMN, ROW, SIDE = 12, 2133, 1457, 64  # near Mont Blanc


def mountain():
    """Return heights of 800 to 3,200 m with slopes below 45 degrees at zoom 12, row 0 north."""
    y, x = np.mgrid[:SIDE, :SIDE] / 9.0
    return 2000.0 + 600.0 * np.sin(x) * np.cos(y) + 300.0 * np.sin(x / 3.0 + 1.0)


def colours(heights, encoding):
    """Return the three bytes of each height, by separate arithmetic."""
    step, base = STEPS[encoding]
    code = np.rint((heights - base) / step).astype(int)
    return np.stack([code // 65536, code // 256 % 256, code % 256]).astype(np.uint8)


def write_image(path, bands, **options):
    path.parent.mkdir(parents=True, exist_ok=True)
    shape = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
    with rasterio.open(path, "w", **shape, **options) as file:
        file.write(bands)
    return path


def tile(folder, encoding, bands=None):
    path = folder / str(ZOOM) / str(COLUMN) / f"{ROW}.png"
    return write_image(path, colours(mountain(), encoding) if bands is None else bands)


@pytest.mark.parametrize("encoding", STEPS)
def test_a_tile_has_its_heights_and_its_place(tmp_path, encoding):
    """A tile z/x/y.png is recognised, decoded to half a step, and lies where web mercator has it."""
    source = tile(tmp_path, encoding)
    field, report = imported(tmp_path, source)
    assert np.abs(field.heights(slice(None), slice(None))[::-1] - mountain()).max() <= STEPS[encoding][0] * 0.501
    assert report["source_step_m"] == pytest.approx(STEPS[encoding][0] / 2, rel=0.01) and report["crs"] == "EPSG:3857"
    world = 2.0 * math.pi * 6378137.0
    west, north = COLUMN / 2**ZOOM * world - world / 2, world / 2 - ROW / 2**ZOOM * world
    half = world / 2**ZOOM / 2
    assert field.origin[:2] == pytest.approx([west + half, north - half], abs=1e-6)
    assert report["step_m"] == pytest.approx([2 * half / SIDE] * 2)


@pytest.mark.parametrize("bands, flags", [(1, "2"), (3, "0")], ids=["one for all bands", "one for each band"])
def test_a_mask_beside_a_tile_counts(tmp_path, bands, flags):
    source = tile(tmp_path, "terrarium")
    mask = np.full((bands, SIDE, SIDE), 255, np.uint8)
    mask[:, 5, 7:11] = 0
    beside = write_image(tmp_path / "mask.tif", mask, driver="GTiff")
    with rasterio.open(beside, "r+") as file:
        file.update_tags(INTERNAL_MASK_FLAGS_1=flags, INTERNAL_MASK_FLAGS_2=flags, INTERNAL_MASK_FLAGS_3=flags)
    beside.rename(f"{source}.msk")
    raster = open_source(ImportSettings(str(source)))
    assert np.array_equal(np.isnan(raster.read(0, SIDE)), mask[0] == 0)


def test_control_points_place_coded_heights(tmp_path):
    source = write_image(tmp_path / "a.png", colours(mountain(), "mapbox"))
    corners = ((0, 0), (SIDE, 0), (0, SIDE))
    points = "".join(f'<GCP Id="" Pixel="{c}" Line="{r}" X="{6e5 + 10 * c}" Y="{5.2e6 - 20 * r}"/>' for c, r in corners)
    gcps = f'<PAMDataset><GCPList Projection="EPSG:32632">{points}</GCPList></PAMDataset>'
    (tmp_path / "a.png.aux.xml").write_text(gcps)
    report = imported(tmp_path, source, encoding="mapbox")[1]
    assert (report["step_m"], report["crs"], report["warnings"]) == ([10.0, 20.0], "EPSG:32632", [])


@pytest.mark.parametrize("encoding", STEPS)
def test_reprojected_codes_are_decoded_first(tmp_path, encoding):
    """Reprojected heights stay within those of the tile, which a mean of colours would leave by more than 100 m."""
    raster = open_source(ImportSettings(str(tile(tmp_path, encoding)), project="utm"))
    rows = raster.read(0, raster.height) * raster.scale + raster.offset
    low, high = mountain().min() - 0.1, mountain().max() + 0.1
    assert np.isfinite(rows).mean() > 0.9 and low <= np.nanmin(rows) and np.nanmax(rows) <= high
    assert raster.georeference.crs == "EPSG:32632" and raster.projected_from == "EPSG:3857"
    assert np.abs(np.diff(rows, axis=1))[np.isfinite(np.diff(rows, axis=1))].max() < 200.0


def test_the_child_process_reads_tiles_and_named_encodings(tmp_path):
    source = tile(tmp_path, "terrarium")
    assert describe_source(ImportSettings(str(source)))["crs"] == "EPSG:3857"
    image = write_image(tmp_path / "a.png", colours(mountain(), "mapbox"))
    report = import_source(ImportSettings(str(image), encoding="mapbox"), tmp_path / "store")
    assert (report["lowest_m"], report["highest_m"]) == pytest.approx((mountain().min(), mountain().max()), abs=0.051)
    assert report["crs"] == "" and report["step_m"] == [1.0, 1.0]


def test_transparent_and_empty_codes_are_missing(tmp_path):
    bands = np.concatenate([colours(mountain(), "mapbox"), np.full((1, SIDE, SIDE), 255, np.uint8)])
    bands[:, 5, 6], bands[3, 7, 8] = 0, 0
    raster = open_source(ImportSettings(str(tile(tmp_path, "mapbox", bands))))
    assert np.argwhere(np.isnan(raster.read(0, SIDE))).tolist() == [[5, 6], [7, 8]]


def test_a_webp_without_loss_is_read_and_one_with_loss_refused(tmp_path):
    bands = colours(mountain(), "terrarium")
    plain = write_image(tmp_path / "a.tif", bands, driver="GTiff")
    for name, lossless in (("a.webp", "YES"), ("b.webp", "NO")):
        rasterio.shutil.copy(plain, tmp_path / name, driver="WEBP", LOSSLESS=lossless)
    raster = open_source(ImportSettings(str(tmp_path / "a.webp"), encoding="terrarium"))
    rows = raster.read(0, SIDE) * raster.scale + raster.offset
    assert np.abs(rows - mountain()).max() <= 0.5 / 256
    with pytest.raises(TerrainError, match="compressed with loss"):
        open_source(ImportSettings(str(tmp_path / "b.webp"), encoding="terrarium"))


def test_pictures_are_never_taken_for_heights(tmp_path):
    """A photo, a dark picture and a shaded relief in a tile's place are not decoded, and PLAIN switches it off."""
    random = np.random.default_rng(5)
    grey = np.repeat(np.clip(mountain()[None] / 15.0, 0, 255).astype(np.uint8), 3, axis=0)
    dark = random.integers(0, 3, (3, SIDE, SIDE)).astype(np.uint8)
    for bands in (random.integers(0, 256, (3, SIDE, SIDE)).astype(np.uint8), dark, grey):
        raster = open_source(ImportSettings(str(tile(tmp_path, "", bands))))
        assert raster.stored == "uint8" and "--encoding" in " ".join(raster.warnings)
    raster = open_source(ImportSettings(str(tile(tmp_path, "mapbox")), encoding="plain"))
    assert raster.stored == "uint8"


def test_an_encoding_needs_three_bands_of_bytes(tmp_path):
    grey = write_image(tmp_path / "a.png", np.zeros((1, 4, 4), np.uint16))
    with pytest.raises(TerrainError, match="holds 1 band.* of uint16, so no heights coded as mapbox"):
        open_source(ImportSettings(str(grey), encoding="mapbox"))
    with pytest.raises(TerrainError, match="'rgb' is not known: choose one of terrarium, mapbox, plain"):
        open_source(ImportSettings(str(grey), encoding="rgb"))


def test_names_of_tiles(tmp_path):
    names = {
        "/t/12/2133/1457.png": (12, 2133, 1457),
        "t/0/0/0.webp": (0, 0, 0),
        "/t/3/7/7@2x.png": (3, 7, 7),
        "/t/3/8/7.png": None,
        "/t/31/0/0.png": None,
        "/t/a/7/7.png": None,
        "7.png": None,
    }
    assert {name: tile_of(Path(name)) for name in names} == names
    assert may_be_coded(Path("a.png"), "mapbox") and not may_be_coded(Path("a.png"), "")
    assert codes_of(np.array([[[1]], [[2]], [[3]]], np.uint8)).tolist() == [[66051]]


def test_an_older_stores_digest_stays_the_same(tmp_path):
    """Settings that older versions lack change the digest of a source only if they are given."""
    source = write_image(tmp_path / "a.png", np.zeros((3, 4, 4), np.uint8))
    stat, values = source.stat(), dataclasses.asdict(ImportSettings(str(source)))
    added = "encoding", "cell", "more_sources", "priority", "step", "blend", "quick", "loaded_tiles", "loaded_finer"
    older = {name: value for name, value in values.items() if name not in added}
    parts = [2, 6, older, (str(source.resolve()), stat.st_size, stat.st_mtime_ns)]
    wanted = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    assert source_digest(ImportSettings(str(source))) == wanted
    assert source_digest(ImportSettings(str(source), encoding="mapbox")) != wanted
