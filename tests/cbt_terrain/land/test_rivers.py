# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivers: against fastscapelib, and what they must leave alone, keep and come to."""

from dataclasses import replace

import fastscapelib
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.effects.routing import route
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.land import fluvial
from adaptive_terrain.cbt_terrain.land.fluvial import Bed, step
from adaptive_terrain.cbt_terrain.land.land_effect import Change, Ground
from adaptive_terrain.cbt_terrain.land.levels import apply_by_levels, coarser, finer
from adaptive_terrain.cbt_terrain.land.rivers import RIVERS, grow

PLAIN = {"hillslope": 0.0, "creep": 0.0, "variety": 0.0, "deposition": 0.0, "steepest": 89.9, "sea": -9000.0}
LAYERS = ("sediment", "wear", "flow")


@pytest.fixture
def still(monkeypatch):
    """Receivers without noise."""
    monkeypatch.setattr(fluvial, "JITTER", 0.0)


def rough(rows, columns, seed=2):
    """Hills of 200 m with pits between, above 20 m, and a sea in one corner."""
    rng = np.random.default_rng(seed)
    y, x = np.indices((rows, columns))
    h = 110 + 60 * np.sin(x / 17) * np.cos(y / 23) + 12 * rng.standard_normal((rows, columns))
    return np.where(np.hypot(y, x) < rows / 3, -3.0, np.maximum(h, 20.0)).astype(np.float32)


def bed_of(h, step_x, step_y, **other):
    n = h.size
    given = {"part": np.ones(n, np.float32), "soft": np.ones(n, np.float32), "lift": np.zeros(n, np.float32)}
    given |= {"fixed": np.zeros(n, bool), "sediment": np.zeros(n, np.float32), "own": np.ones(n)} | other
    return Bed(h.shape, step_x, step_y, h.reshape(-1).copy(), **given)


def aged(h, spacing, **given):
    ground = Ground(
        h, spacing, spacing, **{k: given.pop(k) for k in ("mask", "missing", "seed", "threads") if k in given}
    )
    return apply_by_levels(RIVERS, ground, RIVERS.defaults() | given)


@pytest.mark.parametrize("years", [1e3, 1e5])
def test_heights_are_fastscapelibs_where_there_are_no_pits(still, years):
    """And so float32 gives what its float64 does, to 1e-3 m."""
    rows, columns, step_x, step_y = 97, 121, 32.0, 27.0
    y, x = np.indices((rows, columns))
    cone = 1000 - np.hypot((x - 60) * step_x, (y - 48) * step_y) / 4
    h = (cone + 4 * np.random.default_rng(3).random((rows, columns))).astype(np.float32)
    assert np.array_equal(route(h, step_x, step_y).filled(), h.reshape(-1)), "no pits"
    grid = fastscapelib.RasterGrid([rows, columns], [step_y, step_x], fastscapelib.NodeStatus.FIXED_VALUE)
    graph = fastscapelib.FlowGraph(grid, [fastscapelib.SingleFlowRouter()])
    eroder = fastscapelib.SPLEroder(graph, k_coef=1e-5, area_exp=0.5, slope_exp=1.0, tolerance=1e-6)
    expected, area = h.astype(np.float64), np.empty(h.shape)
    bed = bed_of(h, step_x, step_y)
    for number in range(3):
        graph.update_routes(expected)
        graph.accumulate(area, 1.0)
        expected -= eroder.erode(expected, area, years)
        step(bed, years, RIVERS.defaults() | PLAIN | {"erodibility": 1e-5}, number)
    # Where two ways down are about as steep, rounding decides.
    off = np.abs(bed.heights.reshape(h.shape) - expected)
    assert np.mean(np.abs(expected - h)) > (0.5 if years == 1e3 else 50) and np.quantile(off, 0.995) < 1e-3


def test_what_is_cut_is_laid_down_or_leaves():
    """Hard case 55; creep only exchanges, see below."""
    h = rough(83, 140)
    fixed = (h <= 0).reshape(-1)
    lift = np.where(fixed, 0, 3e-4 * np.random.default_rng(1).random(h.size)).astype(np.float32)
    part = np.random.default_rng(2).random(h.size).astype(np.float32)
    bed = bed_of(h, 12.0, 9.0, fixed=fixed, lift=lift, part=part)
    values, left, moved, raised = RIVERS.defaults() | {"deposition": 2.0, "creep": 0.0}, 0.0, 0.0, 0.0
    for number in range(5):
        before = bed.heights.astype(np.float64)
        lifted = bed.heights + np.float32(20e3) * lift
        load = step(bed, 20e3, values, number)
        left += load[route(before.astype(np.float32).reshape(h.shape), 12.0, 9.0, fixed.reshape(h.shape)).to == 4].sum()
        moved += np.abs(bed.heights - before).sum()
        raised += (lifted.astype(np.float64) - before).sum()
    change = bed.heights.sum(dtype=np.float64) - h.sum(dtype=np.float64)
    assert moved > 1e5 and abs(change + left - raised) < 1e-6 * moved
    assert bed.sediment.sum() > 1e3 and (bed.sediment >= 0).all()


@pytest.mark.parametrize("spread", [30.0, 600.0])
def test_creep_only_exchanges(spread):
    """In both of its ways, away from where water leaves."""
    h = np.full((83, 140), 50.0, np.float32)
    h[35:45, 60:80] = rough(10, 20)
    bed = bed_of(h, 12.0, 9.0)
    fluvial._creep(bed, bed.drain(), spread)
    change = bed.heights.astype(np.float64) - h.reshape(-1)
    assert np.abs(change).sum() > 1e3 and abs(change.sum()) < 1e-5 * np.abs(change).sum()


def test_rock_worn_and_sediment_make_up_the_change():
    h = rough(90, 130)
    made = aged(h, 20.0, years=2e5, rise=1e-4)
    lift = np.where(h > 0, 1e-4 * 2e5, 0)
    lift[[0, -1]] = lift[:, [0, -1]] = 0
    expected = lift - made.layers["wear"] + made.layers["sediment"]
    assert np.allclose(made.heights, expected, atol=0.01) or np.abs(made.heights - expected).max() < 0.01
    assert all((made.layers[name] >= 0).all() and made.layers[name].dtype == np.float32 for name in LAYERS)


@pytest.mark.parametrize("shape", [(300, 411)])
def test_threads_change_no_bit_and_seeds_do(shape):
    """Hard case 58."""
    h, found = rough(*shape), []
    for threads in (1, 2, 3):
        made = aged(h, 15.0, threads=threads, seed=4)
        found.append([made.heights.tobytes(), *(made.layers[name].tobytes() for name in LAYERS)])
    assert found[0] == found[1] == found[2]
    assert aged(h, 15.0, seed=5).heights.tobytes() != found[0][0]


def test_the_sea_holes_and_what_is_masked_stay():
    h = rough(131, 97)
    missing, mask = np.zeros(h.shape, bool), np.ones(h.shape, np.float32)
    missing[60:70, 50:66] = True
    mask[:, :20], mask[:, 20:30] = 0.0, 0.5
    made = aged(h, 20.0, mask=mask, missing=missing, rise=1e-4)
    still = (h <= 0) | missing | (mask == 0)
    assert not made.heights[still].any() and np.abs(made.heights[~still]).mean() > 5
    assert not made.layers["wear"][still].any() and (h + made.heights)[h > 0].min() >= 0
    assert not any(a.any() for a in (aged(h, 20.0, years=0.0).heights, aged(h, 20.0, years=0.0).layers["wear"]))


def test_rims_are_no_dams():
    """A valley that leaves the raster is cut through its rim, as deep as beside it, if not below the lowest; a rim
    never rises."""
    y, x = np.indices((80, 120))
    h = (50 + 1.0 * np.abs(x - 60) + 0.5 * y + 3 * np.random.default_rng(0).random((80, 120))).astype(np.float32)
    h[-1, 5] = 20.0
    made = aged(h, 30.0)
    assert made.heights[0, 55:66].mean() < -5
    after = np.maximum(h[0] + np.minimum(made.heights[1], 0), 20.0)
    assert np.allclose((h + made.heights)[0, 1:-1], after[1:-1], atol=1e-3) and not made.heights[-1, 5]
    assert (aged(h, 30.0, rise=5e-4).heights[[0, -1]] <= 0).all()


def test_a_pit_keeps_all_that_falls_into_it():
    """Hard case 54: a closed bowl fills to no more than its outlet."""
    y, x = np.indices((61, 75))
    h = (100 + 0.8 * np.hypot(x - 37, y - 30)).astype(np.float32)
    made = aged(h, 10.0, years=50e3, creep=0.0)
    laid = made.layers["sediment"]
    assert laid.sum() > 0.8 * made.layers["wear"].sum() > 500 and (laid > 0.5).sum() > 50
    assert (h + made.heights)[laid > 0.5].max() < 125 and abs(made.heights[1:-1, 1:-1].sum()) < 0.01


def test_a_plateau_is_cut_from_all_sides_alike():
    """Hard case 54: no direction is preferred."""
    h = np.full((257, 257), -1.0, np.float32)
    h[28:-28, 28:-28] = 300.0
    taken = -aged(h, 20.0, variety=0.0, steepest=89.0).heights
    north, south, east, west = (np.rot90(taken, k)[28:60, 60:-60].mean() for k in (0, 2, 1, 3))
    sides = np.array([north, south, east, west])
    assert sides.min() > 20 and np.ptp(sides) < 0.08 * sides.mean()


def test_a_steady_range_falls_as_the_uplift_asks(still):
    """K (A + A0)^(1/2) S is the uplift wherever water runs."""
    rng = np.random.default_rng(5)
    start, spacing = (1 + rng.random((70, 90))).astype(np.float32), 100.0
    uplift = np.full(start.shape, 5e-4, np.float32)
    kept = {"hillslope": 5e3, "creep": 0.0, "variety": 0.0, "deposition": 0.0, "steepest": 89.0}
    h = start + grow(start, uplift, spacing, years=30e6, **kept).heights
    drainage = route(h, spacing, spacing)
    area, to = drainage.catchments * spacing**2, drainage.to.astype(int)
    at = np.flatnonzero(to != 4)
    other = at + (to[at] // 3 - 1) * 90 + to[at] % 3 - 1
    away = spacing * np.where(to[at] % 2, 1.0, 2**0.5)
    slope = (h.reshape(-1)[at].astype(np.float64) - h.reshape(-1)[other]) / away
    rate = 1e-5 * np.sqrt(area[at] + 5e3) * slope
    assert np.quantile(np.abs(rate / 5e-4 - 1), 0.98) < 0.01


def test_a_grown_range_converges():
    """Hard case 56: twice the samples, the same range: to 2.5 % of its relief, and so the mean height."""
    fine = island(1025)
    uplift, spacing, made = np.full(fine.shape, 5e-4, np.float32), SIDE / 1024, {}
    for every in (1, 2):
        h = np.ascontiguousarray(fine[::every, ::every])
        made[every] = h + grow(h, uplift[::every, ::every], spacing * every, threads=2).heights
    apart, relief = made[1][::2, ::2] - made[2], made[1].max()
    assert relief > 300 and np.sqrt(np.mean(apart.astype(np.float64) ** 2)) < 0.025 * relief
    land = made[2] > 0
    assert abs(apart[land].mean()) < 0.05 * made[2][land].mean()


def test_a_tile_is_as_the_whole():
    """Hard case 57: to 5 % of what the level moved, with its halo and the water that comes over its cut."""
    fine = island(513)
    spacing, values = SIDE / 512, RIVERS.defaults()
    whole = Ground(fine, spacing, spacing, whole=fine.shape, seed=3)
    below = replace(whole, heights=coarser(fine), step_x=2 * spacing, step_y=2 * spacing, level=1)
    coarse = apply_by_levels(RIVERS, below, values)
    up = Change(finer(coarse.heights, fine.shape), {k: finer(a, fine.shape) for k, a in coarse.layers.items()})
    full = RIVERS.apply(whole, values, up)
    halo = round(RIVERS.halo(values, spacing) / spacing)
    for row, column, side in ((151, 167, 64), (230, 101, 80)):
        cut = np.s_[row - halo : row + side + halo, column - halo : column + side + halo]
        tile = replace(whole, heights=np.ascontiguousarray(fine[cut]), first=(row - halo, column - halo))
        alone = RIVERS.apply(tile, values, Change(up.heights[cut], {k: a[cut] for k, a in up.layers.items()}))
        inner = np.s_[halo:-halo, halo:-halo]
        off = (alone.heights - full.heights[cut])[inner].astype(np.float64)
        moved = (full.heights - 0.5 * up.heights)[cut][inner]
        assert np.sqrt(np.mean(off**2)) < 0.05 * np.sqrt(np.mean(moved**2))
        for rim in np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]:
            expected = np.where(tile.heights > 0, up.heights[cut], 0)[rim]
            assert np.allclose(alone.heights[rim], expected, atol=1e-3), "the coarser level's"
