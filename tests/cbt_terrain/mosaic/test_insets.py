# SPDX-License-Identifier: GPL-3.0-or-later
"""Blending of insets: equal bits through any window, against distances by brute force, and the stores' digests."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.importing.earlier_import import source_digest
from adaptive_terrain.cbt_terrain.mosaic import insets
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.mosaic.mosaic_source import mosaic_raster, open_composite
from adaptive_terrain.cbt_terrain.mosaic.target_grid import TargetGrid
from adaptive_terrain.cbt_terrain.rasters.grid_pieces import BLOCK, GridPiece
from mosaic_files import EAST, NORTH, UTM32, settings_of, sheet


def read(files, **more):
    composite = open_composite(settings_of(*files, **more), None)
    return composite, *composite.read(0, composite.grid.height)


def places(grid):
    return grid.positions(*np.meshgrid(grid.column + np.arange(grid.width), grid.row + np.arange(grid.height)))


def layers(grid, below, above):
    """Return the heights of two sheets on a grid, the upper one on its samples; NaN where there are none."""
    x, y = places(grid)
    high = np.full(x.shape, np.nan)
    u, v = (np.rint(w).astype(int) for w in above.indices(UTM32, x, y))
    inside = (u >= 0) & (v >= 0) & (u < above.heights.shape[1]) & (v < above.heights.shape[0])
    high[inside] = above.heights[v[inside], u[inside]]
    return below.at(UTM32, x, y), high


def expected_heights(grid, low, high, step):
    """Return blended heights and weights of two layers by brute force; step: samples of the grid in a coarse one."""
    cell = 2 ** int(np.log2(step))
    j, i = (n0 + np.arange(count) for n0, count in ((grid.row, grid.height), (grid.column, grid.width)))

    def distances(marked, side, reach=0):
        """Return distances of nodes, in rings, to the corners of cells with marked samples, and the nodes' numbers."""
        nodes_y, nodes_x = (np.arange(n[0] // side - reach, n[-1] // side + 3 + reach) for n in (j, i))
        rows, columns = np.nonzero(marked)
        cells = np.unique(np.stack([j[rows] // side, i[columns] // side], axis=1), axis=0)
        corners = np.unique(np.concatenate([cells + (a, b) for a in (0, 1) for b in (0, 1)]), axis=0)
        found = np.full((len(nodes_y), len(nodes_x)), 4.0)
        for v, u in corners:
            squares = (nodes_y[:, None] - v) ** 2 + (nodes_x - u) ** 2
            np.minimum(found, np.sqrt(squares) * side / (32 * step), out=found)
        return found, nodes_y, nodes_x

    def between(nodes, v, u):
        """Return bilinear values at rows v and columns u of nodes."""
        q, p = np.floor(v).astype(int), np.floor(u).astype(int)
        t, s = (v - q)[:, None], u - p
        z = (nodes[q][:, p] * (1 - s) + nodes[q][:, p + 1] * s) * (1 - t)
        return z + (nodes[q + 1][:, p] * (1 - s) + nodes[q + 1][:, p + 1] * s) * t

    seams = np.isnan(high) & np.isfinite(low)
    near, nodes_y, nodes_x = distances(seams, cell)
    beyond = distances(np.isfinite(high) & np.isnan(low), cell)[0]
    reach = int(np.ceil(32 * step / (4 * cell)))
    around, wide_y, wide_x = distances(seams, 4 * cell, reach)
    widest = around * np.nan
    for v in range(reach, len(wide_y) - reach):
        for u in range(reach, len(wide_x) - reach):
            widest[v, u] = around[v - reach : v + reach + 1, u - reach : u + reach + 1].max()
    widest = np.nan_to_num(between(widest, nodes_y[:-1] / 4 - wide_y[0], nodes_x[:-1] / 4 - wide_x[0]), nan=4.0)
    near, beyond = near[:-1, :-1], beyond[:-1, :-1]
    width = np.minimum(np.minimum(widest / 4, near + beyond), 1.0)
    part = np.where(near == 0, 0.0, np.minimum(near / np.maximum(width, 1e-300), 1.0))
    z = between(part, (j + 0.5) / cell - nodes_y[0], (i + 0.5) / cell - nodes_x[0])
    weight = 3 * z**2 - 2 * z**3
    blended = low * (1 - weight) + high * weight
    return np.where(np.isnan(low), high, np.where(np.isnan(high), low, blended)), weight


@pytest.fixture(scope="module")
def inset(tmp_path_factory):
    """Write coarse tiles with a gap, and finer ones 5 m higher with holes, partly beyond them; return both sheets."""
    folder = tmp_path_factory.mktemp("inset")
    coarse = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 140, 110)
    fine = sheet(UTM32, EAST + 203, NORTH - 151, 2.0, 2.0, 620, 400, shift=5.0)
    coarse.heights[30:34, 40:44] = np.nan
    fine.heights[200:206, 300:309] = np.nan
    files = [coarse.write(folder / "a.tif")]
    files += [fine.write(folder / f"b{n}.tif", first_column=310 * n, columns=310) for n in (0, 1)]
    return list(map(str, files)), coarse, fine


@pytest.mark.thorough
def test_blended_heights_are_those_by_brute_force(inset):
    files, coarse, fine = inset
    composite, heights, bound = read(files)
    low, high = layers(composite.grid, coarse, fine)
    wanted, weight = expected_heights(composite.grid, low, high, 5.0)
    known = np.isfinite(wanted)
    assert np.abs(heights - wanted)[known].max() <= bound + 1e-9 and bound < 1e-3
    both = np.isfinite(low) & np.isfinite(high)
    assert (both & (weight > 0) & (weight < 1)).mean() > 0.1 and (both & (weight == 1)).mean() > 0.1
    plain = read(files, blend=False)[1]
    assert np.array_equal(heights[weight == 1], plain[weight == 1], equal_nan=True)


def test_blended_heights_have_no_step_at_the_border(inset):
    """Steps between neighbours on the border of the inset are those of the ground, and 5 m without blending."""
    files, coarse, fine = inset
    largest = []
    for blend in (True, False):
        composite, heights, _ = read(files, blend=blend)
        low, high = layers(composite.grid, coarse, fine)
        seam = np.isfinite(low[:, :-1] + low[:, 1:]) & (np.isfinite(high[:, 1:]) != np.isfinite(high[:, :-1]))
        steps = np.diff(heights, axis=1) - np.diff(low, axis=1)
        largest.append(np.abs(steps[seam]).max())
    assert largest[0] < 0.01 and largest[1] > 4.5


@pytest.mark.thorough
def test_any_window_of_an_inset_has_the_same_bits(inset):
    files, _, _ = inset
    _, heights, _ = read(files)
    random, fresh = np.random.default_rng(8), open_composite(settings_of(*files), None)
    for number in range(40):
        if number % 4 == 0:
            fresh = open_composite(settings_of(*files), None)
        row, column = random.integers(0, heights.shape[0]), random.integers(0, heights.shape[1])
        rows, columns = (int(random.integers(1, 200)) for _ in range(2))
        wanted = heights[row : row + rows, column : column + columns]
        part, _ = fresh.read(int(row), wanted.shape[0], int(column), wanted.shape[1])
        assert np.array_equal(part, wanted, equal_nan=True)


def test_heights_above_steps_of_three_levels_are_between_them(tmp_path):
    """A fine inset that lies across the border of a middle one blends to both without a step."""
    coarse = sheet(UTM32, EAST, NORTH, 20.0, 20.0, 80, 60)
    middle = sheet(UTM32, EAST + 403, NORTH - 203, 8.0, 8.0, 100, 100, shift=4.0)
    fine = sheet(UTM32, EAST + 201, NORTH - 401, 2.0, 2.0, 220, 200, shift=8.0)
    files = [str(one.write(tmp_path / f"{n}.tif")) for n, one in enumerate((coarse, middle, fine))]
    composite, heights, _ = read(files)
    low = coarse.at(UTM32, *places(composite.grid))
    inner = np.isfinite(low)[1:, 1:]
    for rise in (np.diff(heights - low, axis=0)[:, 1:], np.diff(heights - low, axis=1)[1:]):
        assert np.abs(rise[inner & np.isfinite(rise)]).max() < 1.0
    u, v = fine.indices(UTM32, *places(composite.grid))
    assert np.nanmax(np.abs(heights - low)[(abs(u - 110) < 10) & (abs(v - 100) < 10)] - 8.0) < 3.0


def test_files_of_one_step_do_not_blend(tmp_path):
    """Neither do files of nearly the same step, a finer file below, and one too small for a ring."""
    first = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 60, 60)
    similar = sheet(UTM32, EAST + 100, NORTH - 100, 6.0, 6.0, 60, 60, shift=5.0)
    fine = sheet(UTM32, EAST + 100, NORTH - 100, 2.0, 2.0, 200, 200, shift=5.0)
    small = sheet(UTM32, EAST + 100, NORTH - 100, 0.5, 0.5, 120, 140, shift=5.0)
    names = {"first": first, "similar": similar, "fine": fine, "small": small}
    paths = {name: str(one.write(tmp_path / f"{name}.tif")) for name, one in names.items()}
    for files in (["first", "similar"], ["fine", "first"], ["first", "small"]):
        composite = open_composite(settings_of(*(paths[name] for name in files)), None)
        assert composite.insets is None
    assert open_composite(settings_of(paths["first"], paths["fine"]), None).insets is not None
    assert open_composite(settings_of(paths["fine"], paths["first"], priority="resolution"), None).insets is not None


def test_only_stores_with_insets_are_imported_again(inset, tmp_path):
    files, _, _ = inset
    with_inset, plain = settings_of(*files), settings_of(*files[1:])
    method = [mosaic_raster(open_composite(one, None), one).method for one in (with_inset, plain)]
    assert method == [1, 0]
    assert source_digest(with_inset) != source_digest(with_inset, (), 1)
    assert source_digest(with_inset) != source_digest(settings_of(*files, blend=False))
    run_mosaic_import(settings_of(*files, step=20.0), tmp_path / "store")
    assert run_mosaic_import(settings_of(*files, step=20.0), tmp_path / "store")["unchanged"]


def test_the_report_names_the_ring_and_unblended_seams(inset, tmp_path):
    files, _, _ = inset
    report = run_mosaic_import(settings_of(*files, step=4.0), tmp_path / "blended")
    plain = run_mosaic_import(settings_of(*files, step=4.0, blend=False), tmp_path / "plain")
    assert report["blend_m"] == 320.0 and "blended to coarser ones over 320 m" in report["bounds_against"]
    assert "blend_m" not in plain and "blended" not in plain["bounds_against"]
    assert report["seam_median_m"] == plain["seam_median_m"] == pytest.approx(5.0, abs=0.5)
    blended, sharp = open_store(tmp_path / "blended"), open_store(tmp_path / "plain")
    assert np.array_equal(np.isnan(blended.samples), np.isnan(sharp.samples))
    assert not np.array_equal(blended.samples, sharp.samples)


@pytest.mark.parametrize(
    "steps",
    [(4.0, 4.0), (4.2, 4.2), (1.03, 3.7), (9.1, 30.0), pytest.param((300.0, 300.0), marks=pytest.mark.thorough)],
)
def test_no_mark_beyond_the_reach_of_a_blend_is_read(steps, monkeypatch):
    grid = TargetGrid("", 0.0, 0.0, 1.0, 1.0, 0, 0, 40 * BLOCK, 40 * BLOCK)
    blend = insets.InsetBlend(np.array([0, 1]), np.array([steps, (1.0, 1.0)]), grid, None)
    piece = GridPiece(20 * BLOCK + 13, 20 * BLOCK + 15, 7, 3)

    def marked_beyond(row, column):
        """Mark all samples of a block that are farther from the piece than the reach."""
        y, x = (n * BLOCK + np.arange(BLOCK) for n in (row, column))
        near_y = (y >= piece.row - blend.reach) & (y < piece.row + piece.rows + blend.reach)
        near_x = (x >= piece.column - blend.reach) & (x < piece.column + piece.columns + blend.reach)
        return {1: np.where(near_y[:, None] & near_x, 0, 1).astype(blend._kind)}

    seen = []
    around = insets.InsetBlend._marks_around

    def noting(self, level, ring, *piece_and, **more):
        seen.append(around(self, level, ring, *piece_and, **more))
        return np.ones_like(seen[-1])

    monkeypatch.setattr(blend, "_marks_of_block", marked_beyond)
    monkeypatch.setattr(insets.InsetBlend, "_marks_around", noting)
    blend._fractions(1, 0, piece)
    assert len(seen) == 2 and not any(marks.any() for marks in seen)
