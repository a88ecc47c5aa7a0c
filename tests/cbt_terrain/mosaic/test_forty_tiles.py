# SPDX-License-Identifier: GPL-3.0-or-later
"""Forty tiles of five kinds, some zipped, form one terrain: heights, seams, coverage and a flight, measured apart."""

import dataclasses
import gzip
import os
import zipfile

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from invariants import assert_invariants
from mosaic_files import DEGREES, UTM32, UTM33, land, moved, sheet, top
from own_surface import mesh_points

# Frames of the flight, and samples along each axis of which one is tested.
FRAMES, EVERY = (20, 1) if int(os.environ.get("ADAPTIVE_TERRAIN_FUZZ", "0")) >= 10_000 else (2, 4)
SECOND = 1 / 3600
WEST, LATITUDE = 10.005, 50.0  # where two bands of Copernicus widths meet
MISSING = slice(24, 48), slice(54, 72)  # of the southern band, a tile that is not there


@pytest.fixture(scope="module")
def mosaic(tmp_path_factory):
    """Return the store of forty tiles, its report, the sheets, and a sheet for each tile in the order of the files."""
    folder = tmp_path_factory.mktemp("forty")
    x, y = (float(v) for v in moved(DEGREES, UTM32, WEST, LATITUDE))
    x3, y3 = (float(v) for v in moved(UTM32, UTM33, x + 250, y + 500))
    north = sheet(DEGREES, WEST, LATITUDE + 24.5 * SECOND, 1.5 * SECOND, SECOND, 50, 24, shift=1.0)
    south = sheet(DEGREES, WEST, LATITUDE + 0.5 * SECOND, SECOND, SECOND, 72, 48, shift=1.0)
    zone33 = sheet(UTM33, x3, y3, 20.0, 20.0, 40, 20, shift=-2.0)
    zone32 = sheet(UTM32, x + 400, y - 200, 15.0, 15.0, 37, 28, shift=0.5)
    feet = sheet(UTM32, x + 200, y - 900, 12.0, 12.0, 20, 20, shift=3.0, unit=0.3048)
    inset = sheet(UTM32, x + 600, y - 300, 1.0, 1.0, 120, 120)
    tiles = []

    def cut(name, one, rows, columns, shared=0, **options):
        """Write a sheet as tiles of `rows` x `columns` samples."""
        for row in range(0, one.heights.shape[0] - shared, rows):
            for column in range(0, one.heights.shape[1] - shared, columns):
                if one is south and row == MISSING[0].start and column == MISSING[1].start:
                    continue
                size = row, rows + shared, column, columns + shared
                one.write(folder / f"{name}_{row:03}_{column:03}.tif", *size, **options)
                part = one.heights[row : row + rows + shared, column : column + columns + shared]
                west, top_ = one.west + column * one.step_x, one.north - row * one.step_y
                tiles.append(dataclasses.replace(one, west=west, north=top_, heights=part))

    cut("a_north", north, 24, 10)
    cut("b_south", south, 24, 18)
    cut("c_33", zone33, 10, 10)
    cut("d_32", zone32, 9, 9, shared=1)
    cut("e_feet", feet, 10, 10, unit=0.3048)
    cut("f_inset", inset, 60, 60)
    import rasterio

    for file in folder.glob("e_feet*.tif"):
        with rasterio.open(file, "r+") as opened:
            opened.units = ("ft",)
    for file in folder.glob("d_32*.tif"):
        with zipfile.ZipFile(file.with_suffix(".zip"), "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(file, "tile.tif")
        file.unlink()
    for file in folder.glob("[ef]_*.tif"):
        file.with_suffix(".tif.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    previews = []
    settings = ImportSettings(str(folder), project=UTM32, blend=False)
    report = run_mosaic_import(settings, folder / "store", lambda *state: previews.extend(state[2:]))
    south.heights[MISSING] = np.nan
    return open_store(folder / "store"), report, previews, [north, south, zone33, zone32, feet, inset], tiles


def positions(field, every=1):
    """Return the coordinates of every n-th sample, row 0 south."""
    rows, columns = field.samples.shape
    lattice = field.lattice
    x = field.origin[0] + (np.arange(columns) - (columns - 1) / 2) * lattice.step_x
    y = field.origin[1] + (np.arange(rows) - (rows - 1) / 2) * lattice.step_y
    return np.meshgrid(x[::every], y[::every])


@pytest.mark.thorough
def test_heights_agree_with_an_independent_sampler(mosaic):
    field, report, _, sheets, tiles = mosaic
    assert len(tiles) == report["files"] == 40 and field.lattice.step_x == 1.0
    x, y = (values.ravel() for values in positions(field))
    chosen = np.random.default_rng(7).choice(x.size, 120_000, replace=False)
    wanted = top(sheets, UTM32, x[chosen], y[chosen])
    known = np.isfinite(wanted)
    assert known.sum() >= 100_000
    off = np.abs(np.asarray(field.samples).ravel()[chosen] - wanted)[known]
    assert off.max() <= field.source_max < 0.01
    # The files store float32 of metres and feet: the rounding is theirs, the rest is due to positions.
    assert 3e-5 <= field.source_max


def test_the_cell_between_bands_of_two_widths_is_filled(mosaic):
    field, _, _, sheets, _ = mosaic
    x, y = positions(field, 5)
    longitude, latitude = moved(UTM32, DEGREES, x, y)
    between = (latitude > LATITUDE + 0.1 * SECOND) & (latitude < LATITUDE + 0.9 * SECOND)
    between &= (longitude > WEST + 2 * SECOND) & (longitude < WEST + 68 * SECOND)
    between &= np.isnan(top(sheets, UTM32, x, y))
    assert between.sum() > 200
    assert np.abs(np.asarray(field.samples)[::5, ::5] - land(x, y) - 1.0)[between].max() < 4.0


def test_seams_are_the_true_ones(mosaic):
    _, report, previews, _, tiles = mosaic
    steps, places = [], []
    for n, upper in enumerate(tiles):
        rows, columns = upper.heights.shape
        side = np.arange(columns), np.arange(rows)
        border = [(side[0], np.zeros(columns)), (side[0], np.full(columns, rows - 1))]
        border += [(np.zeros(rows), side[1]), (np.full(rows, columns - 1), side[1])]
        u, v = (np.concatenate(part).astype(int) for part in zip(*border, strict=True))
        x, y = upper.west + (u + 0.5) * upper.step_x, upper.north - (v + 0.5) * upper.step_y
        for lower in tiles[:n]:
            found = upper.heights[v, u] - lower.at(upper.crs, x, y)
            steps.append(found[np.isfinite(found)])
            places.append(np.stack(moved(upper.crs, UTM32, x, y), axis=1)[np.isfinite(found)])
    steps, places = np.abs(np.concatenate(steps)), np.concatenate(places)
    assert report["seam_samples"] == len(steps) > 1000
    assert report["seam_median_m"] == pytest.approx(np.median(steps), abs=1e-6)
    assert report["seam_max_m"] == pytest.approx(steps.max(), abs=1e-6)
    assert np.abs(places[steps.argmax()] - report["seam_max_at"]).max() < 1e-6
    [preview] = previews
    assert preview["seam_max_m"] == report["seam_max_m"] and preview["files"] == 40


def test_the_gap_is_reported_and_filled(mosaic):
    field, report, previews, sheets, tiles = mosaic
    x, y = positions(field, 11)
    covered = np.zeros(x.shape, int)
    for tile in tiles:
        u, v = tile.indices(UTM32, x, y)
        rows, columns = tile.heights.shape
        covered += (u >= -0.5) & (u < columns - 0.5) & (v >= -0.5) & (v < rows - 0.5)
    assert report["gap_percent"] == pytest.approx(100 * np.mean(covered == 0), abs=0.5)
    assert report["overlap_percent"] == pytest.approx(100 * np.mean(covered > 1), abs=0.5)
    assert report["filled"] == pytest.approx(np.mean(covered == 0) * field.samples.size, rel=0.02)
    assert previews[0]["expected_disk_mb"] > 0 and previews[0]["expected_seconds"] > 0


def on_screen(points, eye, target, width=1920.0, fov_deg=50.0):
    """Return pixels across and up from the picture's middle, and depths in metres, of points [n, 3]."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    seen = points - eye
    depth = seen @ forward
    focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
    return focal * (seen @ right) / depth, focal * (seen @ np.cross(right, forward)) / depth, depth, focal


def test_a_flight_has_no_cracks_and_keeps_its_bound(mosaic):
    """Every frame is one sheet, and no sample in view is further than 1 px from the files' own surfaces on screen."""
    field, _, _, sheets, _ = mosaic
    x, y = positions(field, EVERY)
    wanted = top(sheets, UTM32, x, y)
    wanted = np.where(np.isnan(wanted), np.asarray(field.samples)[::EVERY, ::EVERY], wanted)
    middle = np.array([x.min() + x.max(), y.min() + y.max(), 0.0]) / 2 - field.origin
    terrain, worst = Terrain(field, 2), []
    for frame in range(FRAMES):
        t = frame / (FRAMES - 1)
        eye = np.array([500.0 * t - 600.0, -700.0 + 900.0 * t, 1150.0 - 180.0 * t])
        target = np.array([100.0 + 200.0 * t, 300.0 - 500.0 * t, 800.0])
        update = terrain.update(Criterion(error_px=1.0), [View.look(tuple(eye), tuple(target), clip=(1.0, 1e6))])
        assert_invariants(update.surface, field.lattice)
        assert update.bound_px <= 1.0
        shifted = update.surface.positions - middle
        for u, v, mesh in mesh_points(wanted.shape, EVERY, EVERY, shifted, update.surface.corner_verts, 1):
            place = np.stack([x[v, u], y[v, u]], axis=1) - field.origin[:2]
            across, up, depth, focal = on_screen(np.column_stack([place, wanted[v, u]]), eye, target)
            inside = (depth > 1.0) & (np.abs(across) < 960) & (np.abs(up) < 540)
            other = on_screen(np.column_stack([place, mesh]), eye, target)
            off = np.hypot(across - other[0], up - other[1]) - focal * field.source_max / depth
            worst.append(off[inside].max(initial=0.0))
    assert 0.5 < max(worst) <= 1.0
