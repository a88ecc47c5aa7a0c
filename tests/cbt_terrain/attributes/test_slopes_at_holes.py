# SPDX-License-Identifier: GPL-3.0-or-later
"""At the border of a hole, slopes and normals are those of the known ground, at every level and on every surface."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import pyramid, sky_layer
from adaptive_terrain.cbt_terrain.attributes.attribute import SamplePoints
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.field import continued_slopes, derived_arrays
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from horizons import every_sample
from rasterio.transform import Affine
from rasters import hills, write_raster
from tiled_stores import content, tiled  # noqa: F401

STEP_X, STEP_Y = 10.0, 7.0
EAST, NORTH = 0.8, -0.6  # slopes of the plane, metres a metre
NORMAL = np.array([-EAST, -NORTH, 1.0]) / math.sqrt(2.0)


def holes_of(width: int, height: int) -> np.ndarray:
    """bool: a round hole, one at two borders, a strip along the whole eastern border, and single samples."""
    y, x = np.mgrid[:height, :width]
    missing = (x - 45) ** 2 + (y - 35) ** 2 < 225
    missing[height - 15 :, :30] = missing[:, width - 6 :] = True
    missing[10, 10] = missing[11, 70] = missing[12, 71] = True
    return missing


def plane(width: int = 101, height: int = 77) -> np.ndarray:
    """Return a plane of 45 degrees with holes, float32."""
    y, x = np.mgrid[:height, :width]
    heights = (EAST * STEP_X * x + NORTH * STEP_Y * y + 5.0).astype(np.float32)
    heights[holes_of(width, height)] = np.nan
    return heights


def made(name: str, places: SamplePoints, **parameters) -> np.ndarray:
    effect = ATTRIBUTES[name]
    return effect.make(places, {name: effect.defaults() | parameters}, {})[name]


@pytest.mark.parametrize("level", [0.0, 0.6, 1.0, 2.0, 3.5])
def test_a_plane_has_one_slope_up_to_its_holes(level):
    """Before, 26.6 degrees instead of 45 beside a hole, and less on coarser levels."""
    heights = plane()
    places = every_sample(from_array(heights, STEP_X, STEP_Y, holes=True))
    places = SamplePoints(places.field, places.positions, np.full(len(places), level, np.float32), 1.0)
    known = np.isfinite(heights).ravel()
    assert abs(np.degrees(made("slope", places))[known] - 45.0).max() < 0.01
    assert abs(made("detail_normal", places)[known] - NORMAL).max() < 1e-3
    assert abs(made("mean_curvature", places)[known]).max() < 1e-6


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_the_mesh_is_shaded_as_its_ground(interpolation):
    heights = plane()
    field = interpolated(from_array(heights, STEP_X, STEP_Y, holes=True), interpolation)
    surface = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=0.5)).surface
    assert len(surface.positions) > 500 and abs(surface.normals - NORMAL).max() < 1e-5
    x, y = (np.linspace(*ends, 300) for ends in ((-490.0, 400.0), (-250.0, 250.0)))
    queried = ground_at(field, np.stack([x, y], -1))
    assert 100 < queried.inside.sum() < 300 and abs(queried.normals[queried.inside] - NORMAL).max() < 1e-5


def test_light_has_the_slope_of_the_ground():
    """Above a plane, sweeps and rays see (1 + cos 45) / 2 of the sky."""
    heights = plane()
    places, known = every_sample(from_array(heights, STEP_X, STEP_Y, holes=True)), np.isfinite(heights).ravel()
    assert abs(made("sky", places)[known] - (1.0 + math.sqrt(0.5)) / 2.0).max() < 2e-3
    assert abs(made("ambient_occlusion", places, radius=200.0)[known] - 1.0).max() < 1e-4


def test_slopes_on_rough_ground_are_one_sided():
    """At the straight border of a hole; a corner of it has the mean of both directions."""
    heights = hills(60, 50).astype(np.float32)
    heights[20:30, 25:40] = np.nan
    field = from_array(heights, STEP_X, STEP_Y, holes=True)
    z = heights.astype(float)
    inner = field.samples[21:29, 25]
    assert inner == pytest.approx(2.0 * z[21:29, 24] - z[21:29, 23], abs=1e-3)
    corner = (2.0 * z[20, 24] - z[20, 23] + 2.0 * z[19, 25] - z[18, 25]) / 2.0
    assert field.samples[20, 25] == pytest.approx(corner, abs=1e-3)
    assert np.array_equal(field.samples[np.isfinite(heights)], heights[np.isfinite(heights)])
    assert (field.min_height, field.max_height) == (np.nanmin(heights), np.nanmax(heights))


def test_what_is_beyond_the_first_ring_has_the_nearest_height():
    heights = hills(60, 50).astype(np.float32)
    heights[20:30, 25:40] = np.nan
    field, filled = from_array(heights, holes=True), from_array(heights)
    assert np.array_equal(field.samples[21:29, 26:39], filled.samples[21:29, 26:39])
    assert not np.array_equal(field.samples, filled.samples)


def test_ground_of_a_single_cell_continues():
    """Everything else is one hole."""
    heights = np.full((40, 50), np.nan, np.float32)
    heights[30:32, 7:9] = [[1.0, 2.0], [3.0, 4.0]]
    field = from_array(heights, holes=True)
    expected = [[-2.0, -1.0, 0.0, 1.0], [0.0, 1.0, 2.0, 3.0], [2.0, 3.0, 4.0, 5.0], [4.0, 5.0, 6.0, 7.0]]
    assert np.array_equal(field.samples[29:33, 6:10], expected)
    assert np.degrees(made("slope", every_sample(field))).reshape(40, 50)[30, 7] == pytest.approx(
        math.degrees(math.atan(math.hypot(1.0, 2.0)))
    )


@pytest.mark.parametrize("turn", [0.0, 30.0])
def test_whole_numbers_are_continued_by_tile(tmp_path, tiled, monkeypatch, turn):  # noqa: F811
    """Codes of 16 bits, of several tiles and rows at once, in a raster that is turned; the lowest code stays lowest."""
    numbers = np.round(plane(150, 130) * 10.0).clip(0.0)
    lost = np.isnan(numbers)
    numbers[lost] = 65535.0
    transform = Affine.translation(4e5, 5e6) @ Affine.rotation(turn) @ Affine.scale(STEP_X, -STEP_Y)
    source = write_raster(tmp_path / "a.tif", numbers.astype(np.uint16), crs="EPSG:32632", transform=transform)
    settings = ImportSettings(str(source), no_data=65535.0, holes=True, height_scale=0.1)
    for store, cut, rows in ("whole", None, 128), ("tiled", 5, 11):
        tiled(cut)
        monkeypatch.setattr(continued_slopes, "ROWS", rows)
        report = run_import(settings, tmp_path / store)
    (arrays, text), (wanted, wanted_text) = content(tmp_path / "tiled"), content(tmp_path / "whole")
    assert text == wanted_text and all(np.array_equal(array, wanted[name]) for name, array in arrays.items())
    field, known = open_store(tmp_path / "tiled"), ~lost[::-1]
    assert field.steps is not None and report["lowest_m"] == pytest.approx(0.1 * numbers[~lost].min())
    assert read_json(tmp_path / "tiled")["max_height"] == pytest.approx(0.1 * numbers[~lost].max())
    heights, expected = field.heights(), (np.float32(0.1) * np.where(lost, np.nan, numbers))[::-1]
    assert heights[known] == pytest.approx(expected[known], rel=1e-6)
    filled = from_array(np.where(known, expected, np.nan), holes=True).samples
    assert abs(heights - np.maximum(filled, 0.0)).max() <= 0.051


def test_land_with_holes_is_imported_again(tmp_path):
    """The digest of other imports is that of older versions."""
    np.save(tmp_path / "a.npy", plane())
    settings = {cut: ImportSettings(str(tmp_path / "a.npy"), holes=cut) for cut in (True, False)}
    before = {cut: source_digest(each) for cut, each in settings.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("adaptive_terrain.cbt_terrain.importing.earlier_import.HOLES", 0)
        assert source_digest(settings[True]) != before[True] and source_digest(settings[False]) == before[False]


def test_levels_of_an_older_version_are_computed_again(tmp_path, monkeypatch):
    """Levels with holes have another name in a store, and are found there; without holes it is the old one."""
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 1000)
    np.save(tmp_path / "a.npy", plane())
    for cut, name in (True, pyramid.BESIDE_HOLES), (False, pyramid.PYRAMID):
        run_import(ImportSettings(str(tmp_path / "a.npy"), holes=cut), tmp_path / name)
        levels = [pyramid.level_of(open_store(tmp_path / name).raster, 2).copy() for _ in range(2)]
        assert np.array_equal(*levels)
        assert [file.stem for file in (tmp_path / name).glob("data-*/pyramid*.npy")] == [name]
    assert sky_layer.sky_layer(open_store(tmp_path / pyramid.BESIDE_HOLES), 1.0, 1).rows == 77
