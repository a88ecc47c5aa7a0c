# SPDX-License-Identifier: GPL-3.0-or-later
"""Mosaics that mostly consist of gaps: the store grows with the files, not with the rectangle around them."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.known_ground import ground_fraction, known_tiles_of
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators.water_surface import default_sea
from adaptive_terrain.cbt_terrain.importing import refining
from adaptive_terrain.cbt_terrain.importing.finer_squares import finer_squares
from adaptive_terrain.cbt_terrain.importing.refining import with_loaded
from adaptive_terrain.cbt_terrain.mosaic import finer_plan, mosaic_source, report
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.mosaic.target_grid import TargetGrid
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.query.largest_part import sample_largest_part
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.scatter import squares
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights
from finer_imports import assert_same, make_small
from invariants import assert_invariants
from mosaic_files import EAST, NORTH, UTM32, sheet
from store_exports import run

STEP, WIDE, HIGH = 2.0, 300, 200  # metres and samples of a file
CORNERS = {"a": (EAST, NORTH), "b": (EAST + 12_000.0, NORTH - 9_000.0)}  # of the files, in the north-west
MIDDLE = EAST + 5_000.0, NORTH - 4_100.0  # corner of a file in the gap


@pytest.fixture(scope="module")
def small():
    """Make mosaics large from 2^20 samples on, and windows small."""
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        yield patch


@pytest.fixture(scope="module")
def islands(tmp_path_factory, small):
    """Return the sheets of two files that are 15 km apart, the store of both, and the report."""
    folder = tmp_path_factory.mktemp("islands")
    sheets = {name: sheet(UTM32, *corner, STEP, STEP, WIDE, HIGH) for name, corner in CORNERS.items()}
    for name, one in sheets.items():
        one.write(folder / "files" / f"{name}.tif")
    report = run_mosaic_import(ImportSettings(str(folder / "files")), folder / "store")
    return sheets, folder, report


def points_in(field, sheet_, seed, count=4000):
    """Return points of the terrain between the outer samples of a file, and their coordinates."""
    a, _, c, _, e, f = field.raster.place
    rows, columns = sheet_.heights.shape
    random = np.random.default_rng(seed).random((2, count))
    x = sheet_.west + sheet_.step_x * (0.5 + random[0] * (columns - 1))
    y = sheet_.north - sheet_.step_y * (0.5 + random[1] * (rows - 1))
    return np.stack([(x - c) / a, (y - f) / e], 1), x, y


def test_a_store_of_islands_is_small(islands):
    _, folder, report = islands
    field = open_store(folder / "store")
    assert field.lattice.step_x == 16 * STEP and field.raster.finer.bits == 4
    assert report["finer_step_m"] == [STEP, STEP]
    whole = (12_000 / STEP + WIDE) * (9_000 / STEP + HIGH)  # samples of the rectangle at the files' step
    assert sum(file.stat().st_size for file in folder.glob("store/data-*/*.npy")) < 0.6 * whole  # not 5 bytes each


@pytest.mark.parametrize("name", CORNERS)
def test_heights_of_an_island_are_those_of_its_file(islands, name):
    sheets, folder, _ = islands
    field = open_store(folder / "store")
    places, x, y = points_in(field, sheets[name], seed=1)
    assert np.abs(ground_at(field, places).heights - sheets[name].at(UTM32, x, y)).max() <= field.source_max + 1e-3


def test_the_gap_has_heights_of_its_borders(islands):
    sheets, folder, _ = islands
    field = open_store(folder / "store")
    places = (np.random.default_rng(2).random((2000, 2)) - 0.5) * (12_000.0, 9_000.0)
    known = np.concatenate([one.heights.ravel() for one in sheets.values()])
    heights = ground_at(field, places).heights
    assert known.min() - 1e-3 <= heights.min() and heights.max() <= known.max() + 1e-3


@pytest.mark.parametrize("name", CORNERS)
def test_the_border_of_an_island_is_no_wall(islands, name):
    """Heights outside of a file continue those at its border, with slopes as of its own land."""
    sheets, folder, _ = islands
    field, one = open_store(folder / "store"), sheets[name]
    a, _, c, _, e, f = field.raster.place
    inner = np.abs(np.diff(one.heights, axis=0)).max(), np.abs(np.diff(one.heights, axis=1)).max()
    for side in range(4):
        t = np.random.default_rng(side).random((500, 1))
        out = np.arange(0.0, 80.0, 0.5)  # metres from the outer samples outwards, past the 32 samples of the margin
        width, height = (WIDE - 1) * STEP, (HIGH - 1) * STEP
        x, y = ((t * width, height + out), (t * width, -out), (width + out, t * height), (-out, t * height))[side]
        x, y = np.broadcast_arrays(one.west + 0.5 * STEP + x, one.north - 0.5 * STEP - y)
        places = np.stack([(x.ravel() - c) / a, (y.ravel() - f) / e], 1)
        found = ground_at(field, places)
        heights = np.where(found.inside, found.heights, np.nan).reshape(x.shape)
        # Points are a quarter of a sample apart, so land as steep as in the file has a quarter of its largest step. As
        # much is left for the way to the raster's heights, 32 samples long; a wall had three times all of this.
        steps = np.abs(np.diff(heights, axis=1))
        assert np.nanmax(steps, initial=0.0) < 0.5 * max(inner), side


@pytest.mark.parametrize("name", CORNERS)
def test_a_mesh_of_an_island_keeps_its_bound(islands, name):
    sheets, folder, _ = islands
    field = open_store(folder / "store")
    places, x, y = points_in(field, sheets[name], seed=3)
    middle = places.mean(axis=0)
    update = Terrain(field).update(
        Criterion(error_px=0.0, error_m=0.25), [View.look((*(middle - [0.0, 900.0]), 1500.0), (*middle, 800.0))]
    )
    assert_invariants(update.surface, field.lattice)
    off = mesh_heights(update.surface, places) - sheets[name].at(UTM32, x, y)
    assert np.abs(off).max() <= update.bound_m + field.source_max <= 0.26


def files_at(field, sheets, positions, margin):
    """Return the name of the file within `margin` metres of each position of the terrain's space, "" for none."""
    a, _, c, _, e, f = field.raster.place
    x, y = a * positions[:, 0] + c, e * positions[:, 1] + f
    names = np.full(len(positions), "", "U1")
    for name, one in sheets.items():
        width, height = WIDE * STEP, HIGH * STEP
        is_there = (x > one.west - margin) & (x < one.west + width + margin)
        names[is_there & (y < one.north + margin) & (y > one.north - height - margin)] = name
    return names


def test_the_largest_part_of_islands_is_one_of_them(islands):
    sheets, folder, report = islands
    field = open_store(folder / "store")
    assert report["ground_percent"] == pytest.approx(100.0 * ground_fraction(field), rel=1e-3)
    files = 2 * WIDE * HIGH * STEP**2  # square metres
    assert ground_fraction(field) * np.prod(report["extent_m"]) == pytest.approx(files, rel=0.15)
    part = sample_largest_part(field, 65)
    positions = np.stack(np.meshgrid(part.x, part.y), axis=-1).reshape(-1, 2)
    names, inside = files_at(field, sheets, positions, 1024.0), files_at(field, sheets, positions, -2 * STEP)
    assert len(set(names)) == 1 and names[0] in sheets  # within two tiles of one file
    known, one = inside != "", sheets[names[0]]
    assert known.sum() > 200 and part.is_ground.ravel()[known].all()
    a, _, c, _, e, f = field.raster.place
    expected = one.at(UTM32, *(positions[known] * (a, e) + (c, f)).T)
    assert np.abs(part.heights.ravel()[known] - expected).max() <= field.source_max + 1e-3


def test_an_incomplete_import_has_no_known_gap(islands):
    """Files whose finer tiles are not loaded yet are on the raster alone."""
    field = open_store(islands[1] / "store")
    assert known_tiles_of(field).is_known.any()
    assert known_tiles_of(field.with_raster(provenance=field.provenance | {"loaded_m": [4.0, 2.0]})) is None


def test_scattered_points_are_near_files_only(islands, monkeypatch):
    """No square of the gap is divided, so that points are not too many."""
    sheets, folder, _ = islands
    field = open_store(folder / "store")
    monkeypatch.setattr(squares, "MAX_CANDIDATES", 1 << 16)  # the rectangle has 1.1 million points
    points = scatter_points(field, Scatter(spacing=10.0))
    names = files_at(field, sheets, points.positions[:, :2].astype(np.float64), 1024.0)
    assert (names != "").all() and set(names) == set(sheets)
    inside = files_at(field, sheets, points.positions[:, :2].astype(np.float64), 0.0) != ""
    assert inside.sum() == pytest.approx(2 * WIDE * HIGH * STEP**2 / 100.0, rel=0.02)


def test_a_query_and_an_export_name_the_gap(islands, tmp_path, capsys):
    sheets, folder, report = islands
    middles = [(one.west + WIDE, one.north - HIGH) for one in sheets.values()]
    points = [*middles, (EAST + 6_000.0, NORTH - 1_000.0), (0.0, 0.0)]
    (tmp_path / "points.csv").write_text("x,y\n" + "\n".join(f"{x},{y}" for x, y in points))
    assert run("query", "--store", folder / "store", "--points", tmp_path / "points.csv") == 0
    line = capsys.readouterr().err.strip()
    assert line.endswith("; 1 has no ground, 1 is in a gap between files, with filled heights")
    assert run("tiles", "--store", folder / "store", "--out", tmp_path, "--step", "100") == 0
    line = capsys.readouterr().out.strip()
    percent = 100.0 * report["filled"] / np.prod(report["raster"])
    assert f"{percent:.4g} % of its rectangle is gaps without data" in line and 98.0 < percent < 100.0


def test_inland_water_covers_low_ground_of_files(islands):
    """Filled heights do not count: those of the gap are mostly those of two corners."""
    sheets, folder, _ = islands
    heights = np.concatenate([one.heights.ravel() for one in sheets.values()])
    level = default_sea(open_store(folder / "store"))
    assert 0.01 < (heights < level).mean() < 0.12


def test_a_city_in_a_country_has_no_gap(islands, small, tmp_path):
    """Finer tiles alone are no gap, and the points of a scatter are everywhere."""
    sheet(UTM32, EAST, NORTH, 32.0, 32.0, 120, 120).write(tmp_path / "files" / "a.tif")
    sheet(UTM32, EAST + 1600.0, NORTH - 1600.0, STEP, STEP, WIDE, HIGH).write(tmp_path / "files" / "b.tif")
    report = run_mosaic_import(ImportSettings(str(tmp_path / "files")), tmp_path / "store")
    field = open_store(tmp_path / "store")
    assert field.raster.finer is not None and "ground_percent" not in report
    assert ground_fraction(field) == 1.0 and sample_largest_part(field, 33).is_ground.all()
    assert len(scatter_points(field, Scatter(spacing=50.0))) == pytest.approx((119 * 32 / 50) ** 2, rel=0.03)


def test_a_file_in_the_gap_gives_a_complete_imports_bytes(islands, small, tmp_path):
    sheets, folder, _ = islands
    settings = ImportSettings(str(tmp_path / "files"))
    for name in CORNERS:
        sheets[name].write(tmp_path / "files" / f"{name}.tif")
    run_mosaic_import(settings, tmp_path / "store")
    sheet(UTM32, *MIDDLE, STEP, STEP, WIDE, HIGH, shift=40.0).write(tmp_path / "files" / "c.tif")
    for store in ("store", "whole"):
        run_mosaic_import(settings, tmp_path / store)
    assert_same(tmp_path / "store", tmp_path / "whole")
    assert open_store(tmp_path / "store").key != open_store(folder / "store").key


def test_a_large_gap_is_cut_out_around_the_files(islands, small, tmp_path, monkeypatch):
    """Land ends at most one coarse cell outside of the files, and all their heights are there."""
    sheets, folder, _ = islands
    monkeypatch.setattr(finer_plan, "FEWEST_WITH_HOLES", 1 << 20)
    run_mosaic_import(ImportSettings(str(folder / "files"), holes=True), tmp_path / "store")
    field = open_store(tmp_path / "store")
    cell = field.lattice.step_x
    assert cell == 16 * STEP and field.raster.finer is not None
    update = Terrain(field).update(Criterion(error_px=0.0, error_m=0.25))
    a, _, c, _, e, f = field.raster.place
    east, north = (update.surface.positions[:, :2].astype(np.float64) * (a, e) + (c, f)).T
    used = np.unique(update.surface.triangles)
    is_near = np.zeros(len(used), bool)
    for sheet_ in sheets.values():
        width, height = WIDE * STEP, HIGH * STEP
        x, y = east[used] - sheet_.west, sheet_.north - north[used]
        is_near |= (x > -cell) & (x < width + cell) & (y > -cell) & (y < height + cell)
        places, *at = points_in(field, sheet_, seed=5)
        found = ground_at(field, places)
        assert found.inside.all() and np.abs(found.heights - sheet_.at(UTM32, *at)).max() <= field.source_max + 1e-3
        off = mesh_heights(update.surface, places) - sheet_.at(UTM32, *at)  # fails where no triangle is
        assert np.abs(off).max() <= update.bound_m + field.source_max
    assert is_near.all() and len(used) > 1000


def test_a_full_disk_names_the_remedies_of_a_mosaic(islands, small, tmp_path, monkeypatch):
    _, folder, _ = islands
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=1 << 20))
    for holes, remedy in ((False, r"give a larger step\.$"), (True, "give a larger step, or fill gaps instead")):
        with pytest.raises(TerrainError, match=remedy):
            run_mosaic_import(ImportSettings(str(folder / "files"), holes=holes), tmp_path / "store")


def test_the_time_is_measured_in_a_file_at_its_step(islands, small, monkeypatch):
    """In the middle of the rectangle is no file, and coarse samples are far apart."""
    _, folder, _ = islands
    composite, windows = open_composite(ImportSettings(str(folder / "files")), None), []
    plan, all_files = composite.finer
    read = all_files.read
    monkeypatch.setattr(all_files, "read", lambda *window: windows.append(window) or read(*window))
    assert report._expected_seconds(composite) > 0.0
    top, rows, left, columns = windows[-1]
    middles = (plan.boxes[:, :2] + plan.boxes[:, 2:]) / 2
    assert ((middles >= (left, top)) & (middles < (left + columns, top + rows))).all(axis=1).any()
    composite.close()


def test_widened_samples_do_not_depend_on_their_window():
    """They are means of the known samples around, also where a window begins."""
    rng = np.random.default_rng(6)
    whole = np.where(rng.random((40, 50)) < 0.8, np.nan, rng.random((40, 50)))

    def read(first, count, column, columns):
        return whole[first : first + count, column : column + columns].copy()

    expected = whole.copy()
    for row, column in np.argwhere(np.isnan(whole)):
        near = whole[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        if np.isfinite(near).any():
            expected[row, column] = np.nanmean(near)
    found = mosaic_source._read_widened(read, whole.shape, 0, 40, 0, 50)
    assert np.allclose(found, expected, rtol=1e-14, atol=0, equal_nan=True) and np.isnan(found).any()
    for window in ((0, 7, 3, 20), (31, 9, 0, 5), (12, 1, 49, 1)):
        first, count, column, columns = window
        part = mosaic_source._read_widened(read, whole.shape, *window)
        assert np.array_equal(part, found[first : first + count, column : column + columns], equal_nan=True)


@pytest.mark.parametrize(("side", "bits"), [(1 << 15, 4), (1 << 16, 4), (1 << 18, 6)])
def test_only_a_large_mosaic_of_gaps_has_finer_tiles(side, bits, monkeypatch):
    """Holes need one step up to 2^33 samples; so do files that cover a fifth of the rectangle."""
    monkeypatch.setattr(finer_plan, "FEWEST", 1 << 29)
    grid = TargetGrid(UTM32, 0.0, 0.0, 1.0, 1.0, 0, 0, side, side)
    boxes = np.array([[0, 0, 1500, 1500], [side - 1500, side - 1500, side - 1, side - 1]], float)
    levels, steps = np.zeros(2, np.int64), np.ones(2)
    plan = finer_plan.plan_finer(grid, levels, steps, boxes, holes=False)
    assert plan.bits == bits and plan.grid.step_x == 2**bits
    assert (plan.grid.width - 1) << bits >= side - 1  # all samples are inside
    with_holes = finer_plan.plan_finer(grid, levels, steps, boxes, holes=True)
    assert (with_holes is None) == (side < 1 << 17)
    boxes[0, 2:] = 0.45 * side
    assert finer_plan.plan_finer(grid, levels, steps, boxes, holes=False) is None
    too_large = grid._replace(width=1 << 24, height=1 << 24)
    assert finer_plan.plan_finer(too_large, levels, steps, boxes, holes=False) is None


def test_one_finer_file_does_not_hide_wide_gaps(monkeypatch):
    """A file at 1 m on one at 2 m, and another at 2 m 250 km away: a raster at 2 m would save too little."""
    monkeypatch.setattr(finer_plan, "FEWEST", 1 << 29)
    side = 1 << 18
    grid = TargetGrid(UTM32, 0.0, 0.0, 1.0, 1.0, 0, 0, side, side)
    boxes = np.array(
        [[0, 0, 3000, 3000], [900, 900, 1800, 1800], [side - 3000, side - 3000, side - 1, side - 1]], float
    )
    files = np.array([0, 1, 0]), np.array([2.0, 1.0, 2.0]), boxes
    plan = finer_plan.plan_finer(grid, *files, holes=False)
    assert plan.bits == 6 and len(plan.boxes) == 3 and plan.is_of_gaps


@pytest.mark.thorough
def test_a_first_picture_of_islands_loads_their_squares(islands, small, tmp_path, monkeypatch):
    """Then it has the islands' heights, without the rest of the rectangle."""
    sheets, folder, _ = islands
    for name, value in (("FEWEST", 1), ("BITS", 6), ("FACTOR", 4)):
        monkeypatch.setattr(refining, name, value)
    settings = ImportSettings(str(folder / "files"), quick=8000)
    run_mosaic_import(settings, tmp_path / "store")
    tiles = range(refining.picture_tiles(open_store(tmp_path / "store")))
    run_mosaic_import(with_loaded(settings, tmp_path / "store", tiles), tmp_path / "store")
    squares = finer_squares(open_store(tmp_path / "store"))
    assert squares.there and not squares.loaded and squares.is_coarse
    run_mosaic_import(with_loaded(settings, tmp_path / "store", squares=squares.there), tmp_path / "store")
    field = open_store(tmp_path / "store")
    assert finer_squares(field).loaded == squares.there
    places, x, y = points_in(field, sheets["b"], seed=4)
    off = ground_at(field, places).heights - sheets["b"].at(UTM32, x, y)
    assert np.percentile(np.abs(off), 95) < 1.0  # the nearest sample is up to half a step away
