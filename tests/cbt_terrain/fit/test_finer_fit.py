# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits of rasters with finer tiles: their bound against a dense grid of the same surface."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.accuracy.measure import measure
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.fit.fit import bake, fit
from adaptive_terrain.cbt_terrain.fit.sweeps import Sweeps
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from fields import mesh_heights
from finer_fields import dense_heights, finer_field
from invariants import arrays, assert_invariants

POINTS = 600_000


def dense_points(field: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Return POINTS of all finer samples and middles of finer cells, [n, 2] metres, and the heights there, metres."""
    heights, tiles, lattice = dense_heights(field), field.raster.finer, field.lattice
    middles = 0.25 * (heights[1:, 1:] + heights[:-1, 1:] + heights[1:, :-1] + heights[:-1, :-1])
    found = []
    for values, shift in ((heights, 0.0), (middles, 0.5)):
        y, x = np.mgrid[: values.shape[0], : values.shape[1]] + shift
        part = 1 << tiles.bits
        plane = [(x / part - lattice.cells_x / 2) * lattice.step_x, (y / part - lattice.cells_y / 2) * lattice.step_y]
        found.append((np.stack([p.ravel() for p in plane], 1), values.ravel()))
    plane, values = (np.concatenate(parts) for parts in zip(*found, strict=True))
    some = np.random.default_rng(3).choice(len(values), min(POINTS, len(values)), replace=False)
    return plane[some], values[some]


def interpolating(field: HeightField, error_m: float, **settings) -> int:
    """Return the number of triangles that interpolation needs."""
    return Terrain(field).update(Criterion(error_px=0.0, error_m=error_m, **settings)).triangles


@pytest.mark.parametrize(
    ("bits", "known"),
    [
        (1, ((0, 0),)),
        pytest.param(4, ((2, 3), (3, 3), (3, 2)), marks=pytest.mark.thorough),
        pytest.param(5, ((1, 2), (2, 2)), marks=pytest.mark.thorough),
    ],
)
def test_the_bound_holds_at_finer_samples(bits, known):
    field = finer_field(60, 81, bits, known) if bits != 4 else finer_field()
    plane, heights = dense_points(field)
    for error_m in (6.0, 1.0, 0.2):
        fitted = fit(field, error_m)
        assert_invariants(fitted.surface, field.lattice)
        off = np.abs(mesh_heights(fitted.surface, plane) - heights).max()
        assert off <= fitted.bound_m * (1 + 1e-6) and fitted.bound_m <= error_m
        assert off > 0.3 * error_m, "the bound is not wasteful"
        assert fitted.triangles <= interpolating(field, error_m)


def test_a_fit_takes_fewer_triangles():
    field = finer_field()
    fitted = fit(field, 2.0)
    assert fitted.rounds > 0 and fitted.triangles < 0.85 * interpolating(field, 2.0)


@pytest.mark.thorough
def test_scale_and_offset_and_a_budget():
    field = finer_field()
    plane, heights = dense_points(field)
    for scale, offset, budget in ((-2.0, -1e4, None), (0.5, 300.0, 9000), (1.0, 0.0, 2000)):
        heights_of = {"vertical_scale": scale, "vertical_offset": offset}
        fitted = bake(field, 1.0, fitted=True, max_triangles=budget, **heights_of)
        off = np.abs(mesh_heights(fitted.surface, plane) - (heights * scale + offset)).max()
        assert off <= fitted.bound_m * (1 + 1e-6)
        assert measure(field, fitted.surface, random_points=3000, **heights_of).vertical_max_m <= fitted.bound_m
        if budget:
            assert fitted.triangles <= budget and (fitted.limited == "max_triangles") == (fitted.relaxed > 1.0)


@pytest.mark.thorough
def test_rounding_out_of_reach_is_reported():
    """Heights of a million metres are rounded to 1/16 m in float32, so no mesh holds 0.05 m."""
    field = finer_field(20, 23, 3, ((0, 0),))
    plane, heights = dense_points(field)
    fitted = fit(field, 0.05, vertical_offset=1e6)
    off = np.abs(mesh_heights(fitted.surface, plane) - (heights + 1e6)).max()
    assert off <= fitted.bound_m * (1 + 1e-6) and fitted.bound_m > 0.05 and fitted.limited


def test_only_triangles_at_the_deepest_level_count_so(monkeypatch):
    """Triangles in finer tiles are not split either. If they counted, the depth would be given as the reason."""
    found, real = [], Sweeps.refine

    def refine_once(sweeps: Sweeps, _min_share: float) -> None:
        """Split as if every triangle was too coarse, and end the fit."""
        sweeps.count = sweeps.triangles
        active, worst, level = (sweeps.buffers.numpy(f"fit_{k}")[: sweeps.count] for k in ("active", "worst", "level"))
        active[:], worst[:], sweeps.m.error, sweeps.m.bound = np.arange(sweeps.count), 1.0, 0.0, 0.0
        found.append((int(level.max()), real(sweeps, 0.0), sweeps.fitter.depth))
        raise InterruptedError

    monkeypatch.setattr(Sweeps, "refine", refine_once)
    with pytest.raises(InterruptedError):
        fit(finer_field(60, 81, 1, ((0, 0),)), 0.2)
    [(deepest_level, counts, depth)] = found
    assert deepest_level < depth and counts["splits"] > 0 and counts["deepest"] == 0


def test_threads_do_not_change_a_byte():
    field = finer_field()
    one, other = (fit(field, 1.0, threads=threads) for threads in (1, 2))
    assert arrays(one.surface) == arrays(other.surface) and one.bound_m == other.bound_m
