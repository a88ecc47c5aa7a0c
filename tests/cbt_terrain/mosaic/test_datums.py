# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertical datums: heights are converted by PROJ's grids if there are any. The grids here are planes, known exactly."""

import functools
import os
import struct
import sys
from pathlib import Path

import forked_children
import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.placing import reproject_point
from adaptive_terrain.cbt_terrain.importing.tile_crew import ProcessCrew
from adaptive_terrain.cbt_terrain.mosaic import datums, nearest
from adaptive_terrain.cbt_terrain.mosaic.datums import ShiftNodes
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_info import describe_sources
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import mosaic_raster, open_composite
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.run.child import GRID_FOLDERS
from mosaic_files import DEGREES, EAST, NORTH, UTM32, moved, sheet
from rasterio.enums import Resampling
from tiled_stores import assert_same, tiled  # noqa: F401


def egm96(longitude, latitude):
    """Return metres of the plane that stands for EGM96 above the ellipsoid."""
    return 40.0 + 0.3 * (latitude - 50.0) + 0.2 * (longitude - 10.0)


def egm2008(longitude, latitude):
    """Return metres of a second plane, 3 m lower and turned."""
    return 37.0 - 0.5 * (latitude - 50.0) + 0.4 * (longitude - 10.0)


def write_grid(path, plane, west=-10.0, east=30.0, south=30.0, north=70.0):
    """Write a plane as a GTX, NOAA's format of vertical grids, with steps of one degree."""
    longitude, latitude = np.meshgrid(np.arange(west, east + 1), np.arange(south, north + 1))
    values = plane(longitude, latitude).astype(">f4")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack(">4d2i", south, west, 1.0, 1.0, *values.shape) + values.tobytes())


@pytest.fixture
def files(tmp_path):
    """Write four tiles of one land from west to east, above four surfaces: EGM96, EGM2008, the ellipsoid, unnamed."""
    kinds = [("EPSG:32632+5773", 0.0), ("EPSG:32632+3855", 1.0), ("EPSG:4979", 0.0), (UTM32, 0.0)]
    for n, (crs, own) in enumerate(kinds):
        one = sheet(UTM32, EAST + 400 * n, NORTH, 10.0, 10.0, 41, 41)
        if crs == "EPSG:4979":
            west, north = map(float, moved(UTM32, DEGREES, EAST + 400 * n, NORTH))
            one = sheet(DEGREES, west, north, 1.4e-4, 9e-5, 41, 41)
        i, j = np.meshgrid(np.arange(41) + 0.5, np.arange(41) + 0.5)
        place = moved(one.crs, DEGREES, one.west + i * one.step_x, one.north - j * one.step_y)
        if n < 3:
            one.heights += egm96(*place) - (egm2008(*place) if own else egm96(*place) if n == 0 else 0.0)
        one.write(tmp_path / "tiles" / f"{n}.tif", crs=crs, kind="float64")
    return tmp_path / "tiles"


def test_heights_are_converted_where_proj_has_grids(files, tmp_path, monkeypatch):
    """In the sandbox, with grids in PROJ_DATA, tiles above three surfaces are one land; nothing else is changed."""
    write_grid(tmp_path / "grids" / "egm96_15.gtx", egm96)
    write_grid(tmp_path / "grids" / "egm08_25.gtx", egm2008)
    monkeypatch.setenv("PROJ_DATA", str(tmp_path / "grids"))
    report = import_source(ImportSettings(str(files)), tmp_path / "store")
    [warning] = [text for text in report["warnings"] if "surfaces" in text]
    assert "EGM96 in 1, EGM2008 in 1, the ellipsoid in 1, and 1 name none): they were converted to EGM96" in warning
    field = open_store(tmp_path / "store")
    heights = np.asarray(field.samples)[::-1]
    land = sheet(UTM32, EAST, NORTH, 10.0, 10.0, heights.shape[1], heights.shape[0])
    inner = slice(2, 38), slice(2, 150)
    assert np.abs(heights - land.heights)[:41, :81].max() < 1e-4 < field.source_max < 5e-3
    # The tile in degrees is interpolated from other samples of the same ground.
    assert np.abs(heights - land.heights)[inner].max() < 1.0
    assert report["seam_max_m"] < 1.0 and report["filled"] < 300


@pytest.fixture
def grids(tmp_path, monkeypatch):
    """Return a function that gives the processes of imports the grid of a plane."""
    folders = [str(tmp_path / name) for name in ("new", "grids")]
    monkeypatch.setenv(GRID_FOLDERS, os.pathsep.join(folders))

    def give(name, plane, folder="grids"):
        write_grid(tmp_path / folder / name, plane)
        datums._grid_of.cache_clear()

    yield give
    datums._grid_of.cache_clear()


def bent(longitude, latitude):
    """Return metres of a surface that bilinear shifts do not follow."""
    return egm2008(longitude, latitude) + 3.0 * (np.round(longitude) % 2)


def test_processes_convert_heights_like_one(files, tmp_path, grids, tiled):  # noqa: F811
    """Shifts and interpolated positions may have their largest errors in tiles of different processes."""
    grids("egm96_15.gtx", egm96)
    grids("egm08_25.gtx", bent)
    settings = ImportSettings(str(files))
    tiled(None)
    run_mosaic_import(settings, tmp_path / "whole")
    tiled(5)
    run_mosaic_import(settings, tmp_path / "one")
    crew = ProcessCrew("cbt_terrain.mosaic.import_child", 2)
    try:
        run_mosaic_import(settings, tmp_path / "two", crew=crew)
    finally:
        crew.close()
    for name in ("one", "two"):
        assert_same(tmp_path / name, tmp_path / "whole")


@pytest.mark.parametrize("change", ["another grid", pytest.param("another first file", marks=pytest.mark.thorough)])
def test_tiles_are_read_again_with_other_shifts(files, tmp_path, grids, tiled, change):  # noqa: F811
    grids("egm96_15.gtx", egm96)
    grids("egm08_25.gtx", egm2008)
    settings = ImportSettings(str(files))
    tiled(5)
    run_mosaic_import(settings, tmp_path / "store")
    if change == "another grid":
        grids("egm08_25.gtx", lambda *place: egm2008(*place) + 1.5, "new")
    else:  # whose datum all heights are converted to
        sheet(UTM32, EAST, NORTH, 10.0, 10.0, 41, 41).write(files / "0.tif", crs="EPSG:32632+3855", kind="float64")
    run_mosaic_import(settings, tmp_path / "store")
    tiled(None)
    run_mosaic_import(settings, tmp_path / "whole")
    assert_same(tmp_path / "store", tmp_path / "whole")


@pytest.mark.parametrize("has_overviews", [False, True])
def test_a_quick_import_converts_heights(tmp_path, grids, monkeypatch, has_overviews):
    """A level land above two surfaces stays level, also in means; the errors of shifts are in the bound."""
    grids("egm96_15.gtx", lambda longitude, latitude: 40.0 + 30.0 * (longitude - 10.0))
    grids("egm08_25.gtx", lambda longitude, latitude: 40.0 + 300.0 * (latitude - 50.0))
    for n, crs in enumerate(["EPSG:32632+5773", "EPSG:32632+3855"]):
        one = sheet(UTM32, EAST + 2560 * n, NORTH, 10.0, 10.0, 256, 256)
        i, j = np.meshgrid(np.arange(256) + 0.5, np.arange(256) + 0.5)
        longitude, latitude = moved(UTM32, DEGREES, one.west + 10.0 * i, one.north - 10.0 * j)
        one.heights[:] = 500.0 - (300.0 * (latitude - 50.0) if n else 30.0 * (longitude - 10.0))
        path = one.write(tmp_path / "tiles" / f"{n}.tif", crs=crs, kind="float64", tiled=True)
        if has_overviews:
            with rasterio.open(path, "r+") as opened:
                opened.build_overviews([2, 4, 8], Resampling.average)
    monkeypatch.setattr(nearest, "MAX_UNPACKED", 1)
    report = run_mosaic_import(ImportSettings(str(tmp_path / "tiles"), quick=100), tmp_path / "store")
    heights, steps = open_store(tmp_path / "store").heights()[::-1], report["step_m"]
    east = EAST + 5.0 + steps[0] * np.arange(heights.shape[1])
    north = NORTH - 5.0 - steps[1] * np.arange(heights.shape[0])
    longitude, _ = moved(UTM32, DEGREES, *np.meshgrid(east, north))
    # Means are off their places by 5 samples at most, and the first land falls by 0.4 mm/m.
    assert np.abs(heights - (500.0 - 30.0 * (longitude - 10.0))).max() < (0.1 if has_overviews else 0.01)
    assert (report.get("loaded_from") == "overviews") == has_overviews
    run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "full")
    assert report["source_step_m"] >= 0.9 * open_store(tmp_path / "full").source_max > 0.0


@pytest.mark.thorough
def test_without_a_grid_heights_stay_and_a_warning_tells(files, tmp_path, monkeypatch):
    monkeypatch.setenv("PROJ_DATA", str(tmp_path / "grids"))
    if any((Path(folder) / name).is_file() for folder in datums.SYSTEM_FOLDERS for name in datums.GRIDS["EGM96"]):
        pytest.skip("this computer has a grid")
    write_grid(tmp_path / "grids" / "egm08_25.gtx", egm2008)
    settings = ImportSettings(str(files))
    report = describe_sources(settings)
    [warning] = [text for text in report["warnings"] if "surfaces" in text]
    assert "They were not converted, because a grid of PROJ is missing: get the grids (projsync" in warning
    assert 30.0 < report["seam_max_m"] < 50.0, "the ellipsoid is 40 m below"
    before = mosaic_raster(open_composite(settings, None), settings).sources
    write_grid(tmp_path / "grids" / "egm96_15.gtx", egm96)
    monkeypatch.setenv(GRID_FOLDERS, str(tmp_path / "grids"))
    datums._grid_of.cache_clear()
    after = mosaic_raster(open_composite(settings, None), settings).sources
    datums._grid_of.cache_clear()
    new = [path.name for path in after if path not in before]
    assert new == ["egm96_15.gtx", "egm08_25.gtx"], "so that a store made without grids is imported again"


def test_a_grid_that_ends_in_a_file_converts_nothing(files, tmp_path, monkeypatch):
    monkeypatch.setenv("PROJ_DATA", str(tmp_path / "grids"))
    write_grid(tmp_path / "grids" / "egm96_15.gtx", egm96)
    write_grid(tmp_path / "grids" / "egm08_25.gtx", egm2008, north=50.0)
    report = describe_sources(ImportSettings(str(files)))
    assert any("They were not converted" in text for text in report["warnings"])


@pytest.mark.skipif(sys.platform != "linux", reason="children are forked on Linux")
def test_a_nursery_of_children_ignores_the_folder_of_grids(tmp_path, monkeypatch):
    """The first test that forks a child may have set PROJ_DATA, and rasterio reads it once, when it is imported."""
    monkeypatch.setenv("PROJ_DATA", str(tmp_path / "without_a_table_of_systems"))
    nursery = functools.cache(forked_children._nursery.__wrapped__)
    monkeypatch.setattr(forked_children, "_nursery", nursery)
    try:
        assert reproject_point.__wrapped__(9.0, 0.0, DEGREES, UTM32) == pytest.approx((500_000.0, 0.0), abs=1e-3)
        assert nursery.cache_info().currsize == 1
    finally:
        nursery().close()


def test_shifts_depend_on_the_sample_alone():
    """Nodes are spread from the first to the last sample; any window has the values of the whole."""
    random = np.random.default_rng(3)
    nodes = ShiftNodes(random.standard_normal((5, 7)), (121, 175), 0.0)
    whole = nodes.window(0, 121, 0, 175)
    assert np.abs(whole[::30, ::29] - nodes.metres).max() < 1e-12
    assert whole[7, 9] == pytest.approx(np.average(nodes.metres[:2, :2], weights=np.outer([23, 7], [20, 9])), rel=1e-12)
    for _ in range(20):
        row, column = random.integers(0, 100), random.integers(0, 145)
        assert np.array_equal(nodes.window(row, 20, column, 30), whole[row : row + 20, column : column + 30])
    assert ShiftNodes(nodes.metres[:2, :2], (1, 1), 0.0).window(0, 1, 0, 1)[0, 0] == nodes.metres[0, 0]
