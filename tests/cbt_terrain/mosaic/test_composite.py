# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampling of a mosaic: equal bits through any window, against an independent exact sampler."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic import mosaic_source, positions
from adaptive_terrain.cbt_terrain.mosaic.composite import Composite
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import open_composite
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from mosaic_files import DEGREES, EAST, NORTH, UTM32, UTM33, land, moved, settings_of, sheet, top
from rasterio.transform import Affine, from_origin
from rasters import hills, write_raster


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Write files in degrees, UTM 33 and UTM 32, and return them with their sheets, the last on top."""
    folder = tmp_path_factory.mktemp("three")
    west, north = (float(v) for v in moved(UTM32, DEGREES, EAST, NORTH))
    base = sheet(DEGREES, west, north, 1 / 3600, 1 / 3600, 150, 100, shift=3.0)
    base.heights[40:44, 60:70] = np.nan
    other_west, other_north = (float(v) for v in moved(UTM32, UTM33, EAST + 600, NORTH - 500))
    other = sheet(UTM33, other_west, other_north, 15.0, 15.0, 60, 50, shift=-2.0)
    inset = sheet(UTM32, EAST + 2000, NORTH - 1500, 5.0, 5.0, 80, 60)
    sheets = [base, other, inset]
    files = [str(one.write(folder / f"{n}.tif")) for n, one in enumerate(sheets)]
    return files, sheets


@pytest.mark.parametrize("project", ["", "EPSG:3035"])
def test_any_window_has_the_bits_of_the_whole(three, project):
    files, _ = three
    whole = open_composite(settings_of(*files, project=project), None)
    heights, _ = whole.read(0, whole.grid.height)
    random = np.random.default_rng(4)
    parts = open_composite(settings_of(*files, project=project), None)
    for _ in range(20):
        row, column = random.integers(0, whole.grid.height), random.integers(0, whole.grid.width)
        rows = min(random.integers(1, 200), whole.grid.height - row)
        columns = min(random.integers(1, 300), whole.grid.width - column)
        part, _ = parts.read(int(row), int(rows), int(column), int(columns))
        assert np.array_equal(part, heights[row : row + rows, column : column + columns], equal_nan=True)
    assert 0.0 < np.isnan(heights).mean() < 0.2


@pytest.mark.thorough
@pytest.mark.parametrize("project", ["", "EPSG:3035"])
def test_heights_are_those_of_an_exact_sampler(three, project):
    files, sheets = three
    composite = open_composite(settings_of(*files, project=project, blend=False), None)
    heights, bound = composite.read(0, composite.grid.height)
    x, y = composite.grid.positions(
        *np.meshgrid(
            composite.grid.column + np.arange(composite.grid.width),
            composite.grid.row + np.arange(composite.grid.height),
        )
    )
    wanted = top(sheets, composite.grid.crs, x, y)
    known = np.isfinite(wanted)
    assert known.mean() > 0.8 and np.isfinite(heights[known]).all()
    assert np.abs(heights - wanted)[known].max() <= bound < 0.01
    # Beyond the outer samples of a file half a cell is filled, and nothing else.
    more = np.isfinite(heights) & ~known
    reached = np.zeros_like(known)
    for one in sheets:
        u, v = one.indices(composite.grid.crs, x, y)
        rows, columns = one.heights.shape
        reached |= (np.abs(u - (columns - 1) / 2) <= columns / 2) & (np.abs(v - (rows - 1) / 2) <= rows / 2)
    assert more.any() and reached[more].all()


def test_interpolated_positions_are_within_their_error(three):
    files, _ = three
    composite = open_composite(settings_of(*files), None)
    grid = composite.grid
    lattice = next(one for one in composite.lattices if one.crs == DEGREES)
    nodes = positions.nodes_of(lattice, grid, grid.column // 1024, grid.row // 1024)
    offsets = np.arange(0, 1024, 7)
    columns, rows = np.meshgrid(offsets, offsets)
    x, y = grid.positions(columns + grid.column // 1024 * 1024, rows + grid.row // 1024 * 1024)
    longitude, latitude = moved(grid.crs, DEGREES, x, y)
    exact = (longitude - lattice.origin[0]) * 3600, (lattice.origin[1] - latitude) * 3600
    i, j, s, t = columns // 32, rows // 32, columns % 32 / 32, rows % 32 / 32
    assert nodes.spacing == 32
    for values, wanted, error in ((nodes.u, exact[0], nodes.error_u), (nodes.v, exact[1], nodes.error_v)):
        low = values[j, i] * (1 - s) + values[j, i + 1] * s
        high = values[j + 1, i] * (1 - s) + values[j + 1, i + 1] * s
        assert np.abs(low * (1 - t) + high * t - wanted).max() <= error < 1e-3


def test_tiles_on_the_grid_are_copied_exactly(tmp_path):
    """The store of four tiles has the bytes of the store of the whole file, and its rounding."""
    heights = np.rint(hills(200, 160)).astype(np.int16)
    place = {"crs": UTM32, "transform": from_origin(5e5, 5e6, 10, 10)}
    whole = write_raster(tmp_path / "whole.tif", heights, **place)
    for row, column in ((0, 0), (0, 100), (80, 0), (80, 100)):
        part = heights[row : row + 80, column : column + 100]
        place["transform"] = from_origin(5e5 + 10 * column, 5e6 - 10 * row, 10, 10)
        (tmp_path / "tiles").mkdir(exist_ok=True)
        write_raster(tmp_path / f"tiles/{row}_{column}.tif", part, **place)
    run_import(ImportSettings(str(whole)), tmp_path / "one")
    report = run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "many")
    one, many = open_store(tmp_path / "one"), open_store(tmp_path / "many")
    assert np.array_equal(one.samples, many.samples) and one.samples.dtype == many.samples.dtype == np.uint16
    assert one.raster.digest == many.raster.digest
    assert np.array_equal(one.error, many.error) and np.array_equal(one.ranges, many.ranges)
    assert report["source_step_m"] == 0.5 and report["filled"] == 0


@pytest.mark.thorough
def test_a_store_does_not_depend_on_the_windows_that_are_read(three, tmp_path, monkeypatch):
    files, _ = three
    digests = set()
    for rows in (1, 37, 128):
        monkeypatch.setattr(mosaic_source, "BLOCK_ROWS", rows)
        monkeypatch.setattr("adaptive_terrain.cbt_terrain.rasters.raster.BLOCK_SAMPLES", 1)
        run_mosaic_import(settings_of(*files, step=20.0), tmp_path / str(rows))
        digests.add(open_store(tmp_path / str(rows)).raster.digest)
    assert len(digests) == 1


@pytest.mark.parametrize("shared", [0, 1])
def test_neighbours_have_no_gap_with_or_without_a_shared_row(tmp_path, shared):
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 60, 40)
    west = whole.write(tmp_path / "west.tif", columns=30 + shared)
    east = whole.write(tmp_path / "east.tif", first_column=30)
    for step in (None, 7.0):
        composite = open_composite(settings_of(west, east, step=step), None)
        heights, _ = composite.read(0, composite.grid.height)
        grid = composite.grid
        x, y = grid.positions(*np.meshgrid(grid.column + np.arange(grid.width), grid.row + np.arange(grid.height)))
        assert np.abs(heights - whole.at(UTM32, x, y)).max() < 1e-9
        assert len(composite.lattices) == 1


def test_bands_of_other_widths_have_no_gap(tmp_path):
    """Copernicus tiles are wider north of 50 degrees, and their last row is one step north of the next tile's first."""
    step, west = 1 / 3600, 10.0
    north = sheet(DEGREES, west, 50.02 + step / 2, 1.5 * step, step, 48, 72)
    south = sheet(DEGREES, west, 50.0 + step / 2, step, step, 72, 72)
    files = [str(north.write(tmp_path / "n.tif")), str(south.write(tmp_path / "s.tif"))]
    composite = open_composite(settings_of(*files, project="EPSG:32632", step=9.0), None)
    heights, bound = composite.read(0, composite.grid.height)
    grid = composite.grid
    x, y = grid.positions(*np.meshgrid(grid.column + np.arange(grid.width), grid.row + np.arange(grid.height)))
    _, latitude = moved(UTM32, DEGREES, x, y)
    between = (latitude > 50.0) & (latitude < 50.0 + step)
    between[:, :12] = between[:, -12:] = False
    assert between.sum() > 300 and np.isfinite(heights[between]).all()
    part = (latitude - 50.0) / step
    longitude, _ = moved(UTM32, DEGREES, x, y)
    wanted = part * north.at(DEGREES, longitude, np.full_like(x, 50.0 + step) + 1e-12)
    wanted += (1 - part) * south.at(DEGREES, longitude, np.full_like(x, 50.0) - 1e-12)
    assert np.abs(heights - wanted)[between].max() <= bound + 1e-6
    assert np.abs(heights - land(x, y))[between].max() < 2.0


def test_a_coarse_step_reads_a_few_samples(tmp_path):
    whole = sheet(UTM32, EAST, NORTH, 1.0, 1.0, 500, 400)
    composite = open_composite(settings_of(*[whole.write(tmp_path / "a.tif")] * 2, step=40.0), None)
    heights, bound = composite.read(0, composite.grid.height)
    assert heights.shape == (10, 13) and bound == 0.0
    assert np.array_equal(heights, whole.heights[::40, ::40])


def test_tiles_meet_across_the_date_line(tmp_path):
    step = 1 / 600
    west = sheet(DEGREES, 180 - 60 * step, 0.05, step, step, 60, 60)
    east = sheet(DEGREES, -180.0, 0.05, step, step, 60, 60)
    for one in (west, east):
        one.heights[:] = np.arange(3600).reshape(60, 60)
    files = [str(west.write(tmp_path / "w.tif")), str(east.write(tmp_path / "e.tif"))]
    for order in (files, files[::-1]):
        composite = open_composite(settings_of(*order), None)
        heights, _ = composite.read(0, composite.grid.height)
        assert np.array_equal(heights, np.concatenate([west.heights, east.heights], axis=1))
    utm = open_composite(settings_of(*files, project="utm"), None)
    heights, _ = utm.read(0, utm.grid.height)
    assert np.isfinite(heights[3:-3, 3:-3]).all()


def test_priority_chooses_among_overlapping_files(tmp_path):
    fine = sheet(UTM32, EAST, NORTH, 5.0, 5.0, 40, 40, shift=10.0)
    coarse = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20)
    files = [str(fine.write(tmp_path / "fine.tif")), str(coarse.write(tmp_path / "coarse.tif"))]
    import os

    os.utime(files[0], ns=(10**18, 10**18))
    os.utime(files[1], ns=(10**18 - 10**12, 10**18 - 10**12))
    found = {}
    for priority in ("order", "resolution", "newest"):
        composite = open_composite(settings_of(*files, priority=priority), None)
        heights, _ = composite.read(0, composite.grid.height)
        found[priority] = heights[20, 20]
    assert found["resolution"] == found["newest"] == fine.heights[20, 20]
    assert abs(found["order"] - fine.heights[20, 20] + 10.0) < 1.0


def test_a_missing_sample_is_taken_from_the_next_source(tmp_path):
    below = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 30, 30)
    above = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 30, 30, shift=50.0)
    above.heights[10:20, 5:9] = np.nan
    below.heights[12, 6] = np.nan
    files = [str(below.write(tmp_path / "a.tif")), str(above.write(tmp_path / "b.tif"))]
    composite = open_composite(settings_of(*files), None)
    heights, _ = composite.read(0, composite.grid.height)
    wanted = np.where(np.isnan(above.heights), below.heights, above.heights)
    assert np.array_equal(heights, wanted, equal_nan=True) and np.isnan(heights).sum() == 1


def test_turned_and_mirrored_files_keep_their_ground(tmp_path):
    """A file turned by 30 degrees, one with the south first and a VRT, against their own positions."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 60, 50)
    south_first = write_raster(
        tmp_path / "south.tif",
        whole.heights[::-1].astype(np.float32),
        crs=UTM32,
        transform=Affine(10.0, 0.0, EAST, 0.0, 10.0, NORTH - 500.0),
    )
    turn = Affine.translation(EAST + 1000, NORTH) @ Affine.rotation(-30.0) @ Affine.scale(10.0, -10.0)
    i, j = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    x, y = turn.a * i + turn.b * j + turn.c, turn.d * i + turn.e * j + turn.f
    turned = write_raster(tmp_path / "turned.tif", land(x, y).astype(np.float32), crs=UTM32, transform=turn)
    whole.write(tmp_path / "part.tif", rows=25)
    vrt = tmp_path / "part.vrt"
    vrt.write_text(
        f'<VRTDataset rasterXSize="60" rasterYSize="25"><SRS>{UTM32}</SRS><GeoTransform>{EAST + 2000}, 10, 0, '
        f'{NORTH}, 0, -10</GeoTransform><VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename '
        'relativeToVRT="1">part.tif</SourceFilename><SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="60" '
        'ySize="25"/><DstRect xOff="0" yOff="0" xSize="60" ySize="25"/></SimpleSource></VRTRasterBand></VRTDataset>'
    )
    composite = open_composite(settings_of(south_first, turned, vrt), None)
    heights, _ = composite.read(0, composite.grid.height)
    grid = composite.grid
    x, y = grid.positions(*np.meshgrid(grid.column + np.arange(grid.width), grid.row + np.arange(grid.height)))
    inverse = ~turn
    u, v = inverse.a * x + inverse.b * y + inverse.c - 0.5, inverse.d * x + inverse.e * y + inverse.f - 0.5
    inside = (u >= 0) & (u <= 39) & (v >= 0) & (v <= 39)
    assert inside.sum() > 1000 and np.abs(heights - land(x, y))[inside].max() < 0.5
    assert np.array_equal(heights[:50, :60], whole.heights) and np.isnan(heights[51:, :60]).all()
    vrt_part = whole.heights[:25]
    column = round((EAST + 2005 - grid.x0) / 10) - grid.column
    row = round((grid.y0 - (NORTH - 5)) / 10) - grid.row
    assert np.array_equal(heights[row : row + 25, column : column + 60], vrt_part)


@pytest.mark.parametrize(
    ("west", "rows", "columns", "size"), [(200, 1, 1, (21, 20)), (200, 20, 1, (21, 20)), (0, 1, 20, (20, 21))]
)
def test_files_of_one_row_or_one_sample_fit(tmp_path, west, rows, columns, size):
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20)
    small = sheet(UTM32, EAST + west, NORTH - (0 if west else 200), 10.0, 10.0, columns, rows)
    files = [str(whole.write(tmp_path / "a.tif")), str(small.write(tmp_path / "b.tif"))]
    composite = open_composite(settings_of(*files), None)
    heights, _ = composite.read(0, composite.grid.height)
    assert (composite.grid.width, composite.grid.height) == size
    assert np.array_equal(heights[:20, :20], whole.heights)
    assert np.isnan(heights).sum() == heights.size - 400 - rows * columns


def test_a_file_without_any_height_changes_nothing(tmp_path):
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 20, 20)
    empty = sheet(UTM32, EAST + 50, NORTH - 50, 10.0, 10.0, 10, 10)
    empty.heights[:] = np.nan
    files = [str(whole.write(tmp_path / "a.tif")), str(empty.write(tmp_path / "b.tif"))]
    composite = open_composite(settings_of(*files), None)
    heights, _ = composite.read(0, composite.grid.height)
    assert np.array_equal(heights, whole.heights)


@pytest.mark.parametrize("gap", [False, True])
def test_copied_samples_have_the_bits_of_interpolated_ones(tmp_path, monkeypatch, gap):
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 90, 70)
    whole.heights[20:23, 30:34] = np.nan
    parts = ((0, 40, 0, 50), (0, 40, 45, 45), (41, 29, 0, 90) if gap else (38, 32, 0, 90))
    names = [tmp_path / f"t{number}.tif" for number in range(3)]
    for name, (row, rows, column, columns) in zip(names, parts, strict=True):
        whole.write(name, first_row=row, rows=rows, first_column=column, columns=columns)
    files, copied, copy = list(map(str, names)), [], Composite._copy

    def copy_and_note(composite, piece, values):
        copied.append(copy(composite, piece, values))
        return copied[-1]

    monkeypatch.setattr(Composite, "_copy", copy_and_note)
    windows = [(0, 70, 0, 90), (3, 20, 5, 30), (30, 25, 20, 60)]
    found = [open_composite(settings_of(*files), None).read(*window) for window in windows]
    assert copied == ([False, True, False] if gap else [True, True, True])
    monkeypatch.setattr(Composite, "_copy", lambda *_: False)
    for window, (heights, error) in zip(windows, found, strict=True):
        wanted, largest = open_composite(settings_of(*files), None).read(*window)
        assert np.array_equal(heights, wanted, equal_nan=True) and error == largest == 0.0
    assert np.isnan(found[0][0]).sum() == (12 + 90 if gap else 12)


def test_a_finer_file_below_a_coarser_one_is_named(tmp_path):
    """Files of a folder come in the order of their names, so a city may lie below its country."""
    country, city = sheet(UTM32, EAST, NORTH, 8.0, 8.0, 40, 30), sheet(UTM32, EAST + 80, NORTH - 80, 1.0, 1.0, 60, 50)
    warned = {}
    for folder, names in {"below": ("b", "a"), "above": ("a", "b")}.items():
        for item, name in zip((country, city), names, strict=True):
            item.write(tmp_path / folder / f"{name}.tif")
        for priority in ("order", "resolution"):
            settings = ImportSettings(source=str(tmp_path / folder), priority=priority)
            warnings = run_mosaic_import(settings, tmp_path / f"{folder}_{priority}")["warnings"]
            warned[folder, priority] = [text for text in warnings if "coarser files" in text]
    [text] = warned.pop(("below", "order"))
    assert text.startswith("a.tif lies below") and "--priority resolution" in text
    assert not any(warned.values())


def test_a_file_whose_header_has_changed_stays_refused(three):
    """The second read used its raster unchecked."""
    with closing(open_composite(settings_of(*three[0]), None)) as composite:
        composite.tiles[0] = replace(composite.tiles[0], width=composite.tiles[0].width + 1)
        for _ in range(2):
            with pytest.raises(TerrainError, match="as before.*import again when it is complete"):
                composite.tile_window(0, 0, 2, 0, 2)
        assert not composite._open


@pytest.mark.parametrize("axes", [(0, 10, -10, 0), (0, -10, 10, 0), (0, 10, 10, 0), (-10, 0, 0, -10)])
def test_files_at_right_angles_keep_their_samples(tmp_path, axes):
    """A file turned by 90 or 180 degrees or transposed, between samples of a straight one: samples of its array."""
    a, b, d, e = axes
    values = np.random.default_rng(90).integers(0, 999, (7, 12)).astype(np.float32)
    turned = Affine(a, b, EAST + 500, d, e, NORTH - 500)
    source = write_raster(tmp_path / "turned.tif", values, crs=UTM32, transform=turned)
    straight = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 9, 9).write(tmp_path / "straight.tif")
    composite = open_composite(settings_of(straight, source), None)
    for row, column in np.ndindex(values.shape):
        x, y = turned @ (column + 0.5, row + 0.5)
        k, j = (round(float(number)) for number in composite.grid.indices(x, y))
        found = composite.read(j - composite.grid.row, 1)[0][0, k - composite.grid.column]
        assert found == values[row, column]


def test_a_step_longer_than_the_mosaic_is_refused(tmp_path):
    """Heights of 80 m of ground are no terrain of 700 m; a single row of samples takes a step along it."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 60, 9)
    files = [whole.write(tmp_path / f"{k}.tif", first_column=30 * k, columns=30) for k in range(2)]
    with pytest.raises(TerrainError, match="A step of 700 m is longer than the mosaic of 590 x 80 m"):
        open_composite(settings_of(*files, step=700.0), None)
    rows = [whole.write(tmp_path / f"r{k}.tif", rows=1, first_column=30 * k, columns=30) for k in range(2)]
    assert open_composite(settings_of(*rows, step=100.0), None).grid.height == 1
