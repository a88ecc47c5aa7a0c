# SPDX-License-Identifier: GPL-3.0-or-later
"""Exported rasters, read by other libraries: values, order of rows, georeference."""

from functools import cache

import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators.export import check_export, export_raster
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.cbt_terrain.height_operators.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.placing import Placing, placing_of
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import Affine
from rasters import hills, write_raster

PLACES = {
    "utm": ("EPSG:32632", Affine(30.0, 0, 500_000.0, 0, -20.0, 5_200_000.0)),
    "degrees": ("EPSG:4326", Affine(1 / 3600, 0, 10.25, 0, -1 / 1200, 46.5)),
    "feet": ("EPSG:2263", Affine(30.0, 0, 980_000.0, 0, -30.0, 200_000.0)),
    "south first": ("EPSG:32632", Affine(30.0, 0, 500_000.0, 0, 20.0, 5_200_000.0)),
}


@pytest.mark.parametrize("name", [f"{'n' * 300}/land.tif", f"{'n' * 300}.tif"])
def test_a_path_that_is_too_long_is_refused_before_the_work(tmp_path, name):
    with pytest.raises(TerrainError, match=r"a name of 30\d bytes; expected 255 at most: choose a shorter one"):
        check_export(tmp_path / name)


@pytest.fixture(scope="module")
def shaped(tmp_path_factory):
    """Return a function that imports 333 x 290 pixels with a georeference and adds a layer of marks, once each.

    It returns the heights and the store, beside which the source in.tif is.
    """

    @cache
    def make(place, holes=False):
        tmp_path, heights = tmp_path_factory.mktemp("shaped"), hills(333, 290)
        if holes:
            heights[10:20, 30:50] = np.nan
        crs, transform = PLACES[place]
        write_raster(tmp_path / "in.tif", heights, crs=crs, transform=transform)
        run_import(ImportSettings(str(tmp_path / "in.tif"), holes=holes), tmp_path / "in")
        run_shape(tmp_path / "in", Stack((Entry("hill", {"radius": 1.0, "height": 3.0}),)), tmp_path / "out")
        return heights, tmp_path / "out"

    return make


@pytest.mark.parametrize("place", ["utm", "degrees", "feet"])
def test_a_geotiff_has_the_source_pixels_and_georeference(shaped, tmp_path, place):
    heights, store = shaped(place)
    files = export_raster(store, tmp_path / "old.tif")
    assert [file.name for file in files] == ["old.tif", "old_fresh.tif", "old_mark.tif"]
    with rasterio.open(files[0]) as found, rasterio.open(store.parent / "in.tif") as source:
        assert found.crs == source.crs and found.dtypes == ("float32",) and found.shape == (290, 333)
        for a, b in zip(found.transform[:6], source.transform[:6], strict=True):
            assert a == pytest.approx(b, rel=1e-9, abs=1e-9)
        assert (found.read(1) == heights).all()
    with rasterio.open(files[2]) as found:
        assert (found.read(1) == 3.0).all() and found.descriptions == ("mark",)


def test_holes_are_missing(shaped, tmp_path):
    heights, store = shaped("utm", holes=True)
    export_raster(store, tmp_path / "old.tif", ("heights",))
    with rasterio.open(tmp_path / "old.tif") as found:
        assert np.isnan(found.nodata) and (np.isnan(found.read(1)) == np.isnan(heights)).all()
    assert not (tmp_path / "old_mark.tif").exists()


def test_an_exr_has_the_same_pixels(shaped, tmp_path):
    """290 lines are 18 blocks of 16 and two lines."""
    import OpenEXR

    heights, store = shaped("utm")
    files = export_raster(store, tmp_path / "old.exr")
    for file, expected in zip(files, (heights, None, np.full_like(heights, 3)), strict=True):
        pixels = OpenEXR.File(str(file), separate_channels=True).parts[0].channels["Y"].pixels
        assert pixels.dtype == np.float32 and pixels.shape == (290, 333)
        assert expected is None or (pixels == expected).all()


def test_a_raster_from_south_to_north_is_written_from_the_north(shaped, tmp_path):
    heights, store = shaped("south first")
    files = export_raster(store, tmp_path / "old.tif")
    with rasterio.open(files[0]) as found:
        assert (found.read(1) == heights[::-1]).all()
        assert found.transform[:6] == pytest.approx((30.0, 0, 500_000.0, 0, -20.0, 5_200_000.0 + 20.0 * 290), abs=1e-6)


@pytest.mark.parametrize("suffix", [".tif", ".exr"])
def test_an_export_is_imported_again_bit_for_bit(shaped, tmp_path, suffix):
    _, store = shaped("utm")
    export_raster(store, tmp_path / f"old{suffix}")
    extent = None if suffix == ".tif" else (332 * 30.0, 289 * 20.0)
    run_import(ImportSettings(str(tmp_path / f"old{suffix}"), extent=extent), tmp_path / "again")
    first, again = open_store(store), open_store(tmp_path / "again")
    assert (first.heights() == again.heights()).all()
    assert (first.lattice.step_x, first.lattice.step_y) == (again.lattice.step_x, again.lattice.step_y)
    assert suffix == ".exr" or (first.origin == again.origin).all()


def test_an_extent_in_metres_has_no_georeference(tmp_path):
    write_raster(tmp_path / "in.tif", hills(40, 30), crs="EPSG:32632", transform=PLACES["utm"][1])
    run_import(ImportSettings(str(tmp_path / "in.tif"), extent=(390.0, 580.0)), tmp_path / "in")
    export_raster(tmp_path / "in", tmp_path / "out.tif")
    with rasterio.open(tmp_path / "out.tif") as found:
        assert found.crs is None and found.bounds == (-200.0, -300.0, 200.0, 300.0)


def test_a_rotated_raster_has_no_georeference(tmp_path):
    """The store has the lengths of the steps and the centre, not the angle; shaped or not."""
    turned = Affine(8.0, 12.0, 500_000.0, 6.0, -16.0, 5_200_000.0)
    write_raster(tmp_path / "in.tif", hills(40, 30), crs="EPSG:32632", transform=turned)
    run_import(ImportSettings(str(tmp_path / "in.tif")), tmp_path / "in")
    run_shape(tmp_path / "in", Stack((Entry("hill", {"radius": 1.0, "height": 3.0}),)), tmp_path / "shaped")
    for name in ("in", "shaped"):
        export_raster(tmp_path / name, tmp_path / "out.tif", ("heights",))
        with rasterio.open(tmp_path / "out.tif") as found:
            assert found.crs is None and found.bounds == (-200.0, -300.0, 200.0, 300.0)
        assert placing_of(tmp_path / name) == Placing()


def test_coordinates_without_a_named_system_are_kept(tmp_path):
    """An ASCII grid without a .prj file has such coordinates."""
    write_raster(tmp_path / "in.tif", hills(40, 30), transform=PLACES["utm"][1])
    run_import(ImportSettings(str(tmp_path / "in.tif")), tmp_path / "in")
    export_raster(tmp_path / "in", tmp_path / "out.tif")
    with rasterio.open(tmp_path / "out.tif") as found:
        assert found.crs is None and found.transform == PLACES["utm"][1]


def test_exports_that_cannot_be_written_are_refused(shaped, tmp_path):
    _, store = shaped("utm")
    with pytest.raises(TerrainError, match="expected .tif, .tiff, .exr"):
        export_raster(store, tmp_path / "old.png")
    with pytest.raises(TerrainError, match="no layer 'gold'; expected some of heights, fresh, mark"):
        export_raster(store, tmp_path / "old.tif", ("gold",))
    for name in ("a.tif", "a.exr"):
        with pytest.raises(TerrainError, match="cannot be written"):
            export_raster(store, tmp_path / "nowhere" / name)
    assert not list(tmp_path.glob(".partial*"))


@pytest.mark.parametrize("suffix", [".tif", ".exr"])
def test_an_export_reports_rising_fractions(shaped, tmp_path, suffix):
    (_, store), fractions = shaped("utm"), []
    export_raster(store, tmp_path / f"land{suffix}", on_progress=fractions.append)
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


@pytest.mark.parametrize("suffix", [".tif", ".exr"])
def test_an_export_that_is_stopped_leaves_no_file(shaped, tmp_path, suffix):
    _, store = shaped("utm")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(ZeroDivisionError):
        export_raster(store, tmp_path / f"land{suffix}", on_progress=lambda _fraction: 1 / 0)
    assert sorted(tmp_path.iterdir()) == before
