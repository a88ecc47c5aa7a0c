# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick imports: true samples at the right places, the extent of the complete land, and marks of incomplete stores."""

import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.import_report import describe
from adaptive_terrain.cbt_terrain.importing.thinning import loaded_text, positions, stride_of
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from rasterio.transform import Affine, from_origin
from rasters import hills, write_exr, write_raster

PLACES = {
    "north up": Affine(10, 0, 5e5, 0, -10, 5e6),
    "south first": Affine(10, 0, 5e5, 0, 12, 5e6),
    "east first": Affine(-10, 0, 5e5, 0, -10, 5e6),
    "columns along y": Affine(0, 8, 5e5, 10, 0, 5e6),
    "turned": Affine.translation(5e5, 5e6) @ Affine.rotation(20) @ Affine.scale(10, -10),
}


def terrain_of(rows, place):
    """Return an array in the order of a file as the terrain has it: row 0 south, column 0 west."""
    if place.a == place.e == 0.0:
        rows, place = rows.T, Affine(place.b, 0, 0, 0, place.d, 0)
    rows = rows if place.e > 0 else rows[::-1]
    return rows if place.a > 0 else rows[:, ::-1]


def places_of(count, cells):
    """Return the samples nearest to equal parts of a row by exact fractions, halves up."""
    return [int(Fraction(i * (count - 1), cells) + Fraction(1, 2)) for i in range(cells + 1)]


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("width, height", [(131, 90), pytest.param(129, 97, marks=pytest.mark.thorough)])
def test_samples_are_the_raster_s_own_at_even_steps(tmp_path, place, width, height):
    heights = (10 * hills(width, height)).astype(np.int16)
    source = str(write_raster(tmp_path / "a.tif", heights, crs="EPSG:32632", transform=place, tiled=True))
    report = run_import(ImportSettings(source, quick=300), tmp_path / "quick")
    run_import(ImportSettings(source), tmp_path / "full")
    quick, full = open_store(tmp_path / "quick"), open_store(tmp_path / "full")
    cells_x, cells_y = -(-(width - 1) // 8), -(-(height - 1) // 8)
    wanted = heights[np.ix_(places_of(height, cells_y), places_of(width, cells_x))].astype(np.float32)
    assert np.array_equal(quick.heights(), terrain_of(wanted, place))
    assert np.array_equal(full.heights(), terrain_of(heights.astype(np.float32), place)), "the reference is right"
    assert np.array_equal(quick.origin, full.origin) and quick.crs == full.crs
    assert quick.lattice.rectangle() == pytest.approx(full.lattice.rectangle(), rel=1e-15)
    assert report["full_raster"] == [width, height] and quick.steps == full.steps


def test_a_step_that_divides_the_raster_is_exact(tmp_path):
    source = str(write_raster(tmp_path / "a.tif", hills(257, 129), transform=from_origin(0, 0, 0.3, 0.3)))
    run_import(ImportSettings(source, quick=500), tmp_path / "quick")
    run_import(ImportSettings(source), tmp_path / "full")
    quick, full = open_store(tmp_path / "quick"), open_store(tmp_path / "full")
    assert np.array_equal(quick.heights(), full.heights()[::16, ::16]), "of 257 columns every 16th"
    assert quick.lattice.rectangle() == full.lattice.rectangle()


@pytest.mark.parametrize("count", [1, 2, 3, 17, 100, 1000])
@pytest.mark.parametrize("stride", [2, 8, 64])
def test_positions_have_both_ends_and_even_gaps(count, stride):
    found = positions(count, stride)
    assert found[0] == 0 and found[-1] == count - 1
    gaps = np.diff(found)
    assert len(gaps) == 0 or (gaps.min() >= 1 and gaps.max() <= stride and np.ptp(gaps) <= 1)


def test_the_step_is_the_smallest_power_of_two_that_fits():
    assert stride_of(100_352, 100_352, 9 << 19) == 64
    assert stride_of(8192, 8192, 9 << 19) == 1, "24 s are no long wait"
    for width, height in ((5_000, 5_000), (20_000, 900), (1_000_000, 20)):
        stride = stride_of(width, height, 9_000)
        counts = [len(positions(width, s)) * len(positions(height, s)) for s in (stride, stride // 2)]
        assert counts[0] <= 9_000 < counts[1] and stride & (stride - 1) == 0


def write_npy(path):
    np.save(path, hills(200, 150))
    return path


def write_raw(path):
    (100 * hills(200, 150)).astype("<u2").tofile(path)
    return path


FILES = {
    "npy": lambda folder: {"source": str(write_npy(folder / "a.npy"))},
    "raw": lambda folder: {"source": str(write_raw(folder / "a.raw")), "raw_size": (200, 150), "height_scale": 0.01},
    "exr": lambda folder: {"source": str(write_exr(folder / "a.exr", Y=hills(200, 150))), "extent": (199.0, 149.0)},
    "png": lambda folder: {
        "source": str(write_raster(folder / "a.png", (50 * hills(200, 150)).astype(np.uint16))),
        "height_scale": 0.02,
    },
    "land": lambda folder: {"source": "island", "size": 201},
    "holes": lambda folder: {
        "source": str(write_raster(folder / "b.tif", with_hole(), nodata=-9999.0)),
        "holes": True,
    },
}


def with_hole():
    heights = hills(200, 150)
    heights[40:90, 60:110] = -9999.0
    return heights


@pytest.mark.parametrize("kind", FILES)
def test_every_kind_of_source_is_thinned(tmp_path, kind):
    settings = FILES[kind](tmp_path)
    run_import(ImportSettings(**settings, quick=900), tmp_path / "quick")
    run_import(ImportSettings(**settings), tmp_path / "full")
    quick, full = open_store(tmp_path / "quick"), open_store(tmp_path / "full")
    rows = places_of(full.lattice.height, quick.lattice.cells_y)
    if kind != "land":  # which begins in the south
        rows = [full.lattice.height - 1 - row for row in reversed(rows)]
    columns = places_of(full.lattice.width, quick.lattice.cells_x)
    wanted, found = full.heights()[np.ix_(rows, columns)], quick.heights()
    known = np.ones_like(wanted, bool) if full.valid is None else full.valid[np.ix_(rows, columns)].astype(bool)
    assert 400 < found.size <= 900 and np.array_equal(found[known], wanted[known])
    assert (quick.valid is None) == (full.valid is None) and (known.all() or np.array_equal(quick.valid, known))
    assert quick.lattice.rectangle() == pytest.approx(full.lattice.rectangle(), rel=1e-15)


def write_vrt(folder, side):
    """Write a VRT of `side` x `side` samples over a file of 64 x 64 that are all 7, and return its path."""
    write_raster(folder / "a.tif", np.full((64, 64), 7, np.int16))
    rectangle = f'xOff="0" yOff="0" xSize="{side}" ySize="{side}"'
    (folder / f"{side}.vrt").write_text(
        f'<VRTDataset rasterXSize="{side}" rasterYSize="{side}"><GeoTransform>0, 0.01, 0, 0, 0, -0.01</GeoTransform>'
        '<VRTRasterBand dataType="Int16" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">a.tif</SourceFilename>'
        f'<SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="64" ySize="64"/><DstRect {rectangle}/>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )
    return str(folder / f"{side}.vrt")


@pytest.mark.thorough
def test_a_large_vrt_is_thinned(tmp_path):
    report = import_source(ImportSettings(write_vrt(tmp_path, 40_000), quick=2_000), tmp_path / "store")
    assert report["extent_m"] == pytest.approx([399.99, 399.99]) and report["lowest_m"] == report["highest_m"] == 7


@pytest.mark.thorough
def test_a_store_cannot_hold_more_than_2_to_the_30_a_side(tmp_path):
    source = write_vrt(tmp_path, 1_200_000_000)
    for quick in (0, 2_000):
        with pytest.raises(TerrainError, match="1200000000 x 1200000000 samples; expected at most"):
            import_source(ImportSettings(source, quick=quick), tmp_path / "store")


@pytest.fixture
def source(tmp_path):
    return ImportSettings(str(write_raster(tmp_path / "a.tif", hills(200, 150), transform=from_origin(0, 0, 10, 10))))


def quick_of(settings):
    return ImportSettings(settings.source, quick=600)


def test_an_incomplete_store_says_so(tmp_path, source):
    store = tmp_path / "store"
    report = import_source(quick_of(source), store)
    fields = describe(store)
    assert fields["loaded"] == report["loaded"] == "to 79.6 m of 10 m" and fields["complete"] is False
    assert fields["loaded_step_m"] == pytest.approx(1990 / 25) and fields["full_step_m"] == pytest.approx(10.0)
    assert fields["bounds_against"] == "the surface as loaded so far, to 79.6 m of 10 m"
    assert loaded_text(open_store(store).provenance) == "to 79.6 m of 10 m"
    for wrong in ({}, {"loaded_m": "all"}, {"loaded_m": [1.0]}, {"loaded_m": [float("nan"), 1.0]}):
        assert loaded_text(wrong) == ""


@pytest.mark.thorough
def test_a_complete_import_replaces_a_quick_one(tmp_path, source):
    quick, store = quick_of(source), tmp_path / "store"
    first = import_source(quick, store)
    assert import_source(quick, store) == first | {"unchanged": True}
    report = import_source(source, store)
    plain = import_source(source, tmp_path / "plain")
    assert report | {"seconds": 0} == plain | {"seconds": 0} and "loaded" not in report
    ours, theirs = read_json(store), read_json(tmp_path / "plain")
    for content in (ours, theirs):
        content["report"].pop("seconds")
    assert {**ours, "data": "", "sum": ""} == {**theirs, "data": "", "sum": ""}, "no trace of the quick one is left"
    assert import_source(quick, store) == report | {"unchanged": True}, "a complete store stays"


def test_a_small_source_is_imported_completely(tmp_path, source):
    report = import_source(ImportSettings(source.source, quick=2_000), tmp_path / "store")
    assert "loaded" not in report and import_source(source, tmp_path / "store") == report | {"unchanged": True}


def test_a_quick_store_is_the_same_each_time(tmp_path, source):
    for name in ("one", "two"):
        run_import(quick_of(source), tmp_path / name)
    one, two = (tmp_path / name / read_json(tmp_path / name)["data"] for name in ("one", "two"))
    for file in sorted(path.name for path in one.iterdir() if path.suffix == ".npy"):
        assert (one / file).read_bytes() == (two / file).read_bytes()


def test_a_reprojected_raster_is_loaded_quickly(tmp_path):
    place = from_origin(5e5, 5e6, 10, 10)
    source = str(write_raster(tmp_path / "a.tif", hills(200, 150), crs="EPSG:32632", transform=place))
    settings, store = ImportSettings(source, project="EPSG:32633", quick=300, holes=True), tmp_path / "store"
    report = run_import(settings, store)
    quick = open_store(store)
    full = run_import(replace(settings, quick=0), store)
    complete = open_store(store)
    assert report["full_raster"] == full["raster"] and "loaded" not in full
    rows, columns = (
        places_of(count, few - 1) for count, few in zip(complete.samples.shape, quick.samples.shape, strict=True)
    )
    rows = [complete.lattice.height - 1 - row for row in reversed(rows)]
    known = (quick.valid > 0) & (complete.valid[np.ix_(rows, columns)] > 0)
    assert known.mean() > 0.7 and np.array_equal(quick.valid > 0, complete.valid[np.ix_(rows, columns)] > 0)
    assert np.abs(quick.heights() - complete.heights()[np.ix_(rows, columns)])[known].max() < 0.02
    assert quick.crs == complete.crs and np.array_equal(quick.origin, complete.origin)


def test_a_negative_count_of_samples_is_refused(tmp_path, source):
    with pytest.raises(TerrainError, match="quick import of -1 samples"):
        import_source(ImportSettings(source.source, quick=-1), tmp_path / "store")


def test_provenance_is_plain_json(tmp_path, source):
    run_import(quick_of(source), tmp_path / "store")
    assert json.loads((tmp_path / "store" / "store.json").read_text())["provenance"]["settings"]["quick"] == 600


@pytest.mark.parametrize("kind", PLACES)
def test_an_incomplete_store_has_the_place_of_the_complete_one(tmp_path, kind):
    path = write_raster(tmp_path / "a.tif", hills(200, 150), transform=PLACES[kind], crs="EPSG:32632")
    places = []
    for quick in (600, 0):
        run_import(ImportSettings(str(path), quick=quick), tmp_path / "store")
        places.append(read_json(tmp_path / "store")["place"])
    assert places[0] == pytest.approx(places[1], rel=1e-14, abs=1e-14)
