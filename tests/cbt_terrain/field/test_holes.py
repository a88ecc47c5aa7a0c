# SPDX-License-Identifier: GPL-3.0-or-later
"""Holes of no-data before they are cut out: borders go down to the raster's cells; what fills them does not count."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.fit.fit import fit
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.operators.cli import command_line
from own_surface import distances
from rasters import hills

STEP = 10.0


def raster(width: int = 70, height: int = 50) -> np.ndarray:
    """Return hills with a round lake without data, a single missing sample, and a missing corner."""
    heights = hills(width, height).astype(np.float32)
    y, x = np.mgrid[:height, :width]
    heights[(x - 30) ** 2 + (y - 20) ** 2 < 80] = np.nan
    heights[45, 10] = heights[12, 60] = np.nan
    heights[-9:, -6:] = np.nan
    return heights


def hole_cells(heights: np.ndarray) -> np.ndarray:
    """bool [rows - 1, columns - 1]: the cells that have a missing corner."""
    lost = np.isnan(heights)
    return lost[1:, 1:] | lost[1:, :-1] | lost[:-1, 1:] | lost[:-1, :-1]


def kinds_of(surface, holes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """bool [T] twice: whether a triangle has points in cells that are holes, and in others. Nothing beyond the rim."""
    rows, columns = holes.shape
    cells = surface.positions[:, :2].astype(np.float64) / STEP + (columns / 2, rows / 2)
    corners = np.ascontiguousarray(cells[surface.triangles].transpose(1, 2, 0)).reshape(3, -1)
    random = np.random.default_rng(0)
    # 0: a hole, 1: another cell, 2: beyond the rim.
    kinds = np.pad(np.where(holes, 0, 1), ((0, 1), (0, 1)), constant_values=2)
    found = np.zeros((3, len(surface.triangles)), bool)
    for weights in random.dirichlet(np.ones(3), 60):
        x, y = np.floor(weights @ corners).astype(int).reshape(2, -1)
        kind = kinds[np.minimum(y, rows), np.minimum(x, columns)]
        for number in range(2):
            found[number] |= kind == number
    return found[0], found[1]


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_no_visible_triangle_crosses_the_border_of_a_hole(interpolation):
    heights = raster()
    field = interpolated(from_array(heights, STEP, holes=True), interpolation)
    assert field.filled == np.isnan(heights).sum() and np.array_equal(field.valid == 0, np.isnan(heights))
    assert np.isfinite(field.samples).all()
    mixed = []
    for error_m in (200.0, 50.0, 5.0):
        surface = Terrain(field, 1, whole=True).update(Criterion(error_px=0.0, error_m=error_m)).surface
        hole, ground = kinds_of(surface, hole_cells(heights))
        corners = surface.positions[surface.triangles][..., :2]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        assert longest[hole & ground].max(initial=0.0) <= error_m, "its border is in the wrong place by no more"
        mixed.append((hole & ground).sum())
    assert mixed[0] > 0 == mixed[-1]


def test_a_bound_holds_on_the_ground_and_holes_are_not_refined():
    heights = raster()
    cut, filled = from_array(heights, STEP, holes=True), from_array(heights, STEP)
    for error_m in (4.0, 0.5):
        update = Terrain(cut, 1, whole=True).update(Criterion(error_px=0.0, error_m=error_m))
        far = distances(cut.samples, STEP, STEP, update.surface.positions, update.surface.corner_verts)
        on_ground = np.kron(~hole_cells(heights), np.ones((4, 4), bool))
        assert far[:-1, :-1][on_ground].max() <= error_m
        hole, _ = kinds_of(update.surface, hole_cells(heights))
        whole = Terrain(filled, 1, whole=True).update(Criterion(error_px=0.0, error_m=error_m)).surface
        assert hole.sum() < 0.3 * kinds_of(whole, hole_cells(heights))[0].sum()


def test_a_hole_in_flat_ground_is_found():
    heights = np.zeros((65, 65), np.float32)
    heights[20:24, 30] = np.nan
    field = from_array(heights, STEP, holes=True)
    assert Terrain(from_array(heights, STEP), 1).update(Criterion(error_px=0.0, error_m=1.0)).triangles == 2
    view = View.look((0.0, -300.0, 300.0), (0.0, 0.0, 0.0), resolution=(640, 480))
    update = Terrain(field, 1, whole=True).update(Criterion(error_px=1.0), [view])
    hole, ground = kinds_of(update.surface, hole_cells(heights))
    assert hole.any() and not (hole & ground).any()
    assert not kinds_of(Terrain(field, 1).update(Criterion(error_px=1.0), [view]).surface, hole_cells(heights))[0].any()
    far_away = View.look((0.0, -3e5, 3e5), (0.0, 0.0, 0.0), resolution=(640, 480))
    assert Terrain(field, 1).update(Criterion(error_px=1.0), [far_away]).triangles < update.triangles / 2


def test_a_store_keeps_holes(tmp_path):
    heights = raster()
    np.save(tmp_path / "a.npy", heights)
    reports = [
        import_source(ImportSettings(source=str(tmp_path / "a.npy"), holes=holes), tmp_path / str(holes))
        for holes in (True, False)
    ]
    lost = int(np.isnan(heights).sum())
    assert [(r["filled"], r["cut_out"]) for r in reports] == [(0, lost), (lost, 0)]
    cut, filled = open_store(tmp_path / "True"), open_store(tmp_path / "False")
    assert np.array_equal(cut.valid[::-1] == 0, np.isnan(heights)) and filled.valid is None and cut.key != filled.key
    assert np.array_equal(cut.samples[cut.valid > 0], filled.samples[cut.valid > 0])
    assert "valid.npy" in verify(tmp_path / "True")
    assert interpolated(cut, "bicubic").valid is cut.valid
    next((tmp_path / "True").glob("data-*/valid.npy")).unlink()
    with pytest.raises(TerrainError, match="lacks valid.npy"):
        open_store(tmp_path / "True")


def test_a_mesh_with_holes_can_be_measured():
    field = from_array(raster(), STEP, holes=True)
    mesh = Terrain(field, 1).update(Criterion(error_px=0.0, error_m=2.0))
    assert 1.0 < measure(field, mesh.surface, random_points=1000, threads=1).vertical_max_m <= 2.0


def test_a_terrain_with_holes_is_not_fitted(tmp_path, capsys):
    """It would fit what fills them. Before, it was baked without the fit, with no reason given."""
    np.save(tmp_path / "a.npy", raster())
    import_source(ImportSettings(source=str(tmp_path / "a.npy"), holes=True), tmp_path / "store")
    with pytest.raises(TerrainError, match="A terrain with holes cannot be fitted") as raised:
        fit(from_array(raster(), STEP, holes=True), 2.0)
    assert "--fit" in raised.value.fix and "--holes" in raised.value.fix
    options = ["--store", str(tmp_path / "store"), "--max-error", "2", "--out", str(tmp_path / "a.npz")]
    assert command_line.main(["bake", *options, "--fit"]) != 0
    assert "A terrain with holes cannot be fitted" in capsys.readouterr().err and not (tmp_path / "a.npz").exists()
    assert command_line.main(["bake", *options]) == 0


def test_a_raster_of_which_holes_leave_nothing_is_refused():
    """Every cell has a missing corner, though most samples are there."""
    heights = hills(9, 7).astype(np.float32)
    heights[1::2, 1::2] = np.nan
    with pytest.raises(TerrainError, match="no cell with four known samples"):
        from_array(heights, holes=True)
    heights[1, 1] = 0.0
    assert Terrain(from_array(heights, holes=True), 1).update(Criterion(error_px=0.0, error_m=0.1)).triangles
