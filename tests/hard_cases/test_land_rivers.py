# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 54 to 58 of rivers: pits, mass, convergence, tiles and threads."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.routing import route
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.height_operators import fluvial
from adaptive_terrain.cbt_terrain.height_operators.fluvial import step
from adaptive_terrain.cbt_terrain.height_operators.height_operator import Change, OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels, coarser, finer
from adaptive_terrain.cbt_terrain.height_operators.rivers import RIVERS
from river_grounds import aged, bed_of, grow, rough

LAYERS = ("sediment", "wear", "flow")


def test_case_54_a_pit_keeps_all_that_rivers_bring():
    """Rivers fill a closed bowl at most to its outlet and keep all sediment in it."""
    y, x = np.indices((61, 75))
    h = (100 + 0.8 * np.hypot(x - 37, y - 30)).astype(np.float32)
    change = aged(h, 10.0, years=50e3, creep=0.0)
    deposited = change.layers["sediment"]
    assert deposited.sum() > 0.8 * change.layers["wear"].sum() > 500 and (deposited > 0.5).sum() > 50
    assert (h + change.heights)[deposited > 0.5].max() < 125 and abs(change.heights[1:-1, 1:-1].sum()) < 0.01


def test_case_54_rivers_cut_a_plateau_from_all_sides_alike():
    """Rivers erode the four sides of a plateau equally to 8 %."""
    h = np.full((257, 257), -1.0, np.float32)
    h[28:-28, 28:-28] = 300.0
    eroded = -aged(h, 20.0, variety=0.0, steepest=89.0).heights
    north, south, east, west = (np.rot90(eroded, k)[28:60, 60:-60].mean() for k in (0, 2, 1, 3))
    sides = np.array([north, south, east, west])
    assert sides.min() > 20 and np.ptp(sides) < 0.08 * sides.mean()


@pytest.mark.parametrize("spread", [30.0, 600.0])
def test_case_55_creep_only_exchanges(spread):
    """Creep keeps mass to 1e-7 of the change away from outlets, by explicit steps and by an implicit one."""
    h = np.full((283, 340), 50.0, np.float32)
    h[135:145, 160:180] = rough(10, 20)
    bed = bed_of(h, 12.0, 9.0)
    heights = fluvial.diffuse(bed, bed.heights.copy(), spread, bed.drain().base, bed.weight)
    change = heights.astype(np.float64) - h.reshape(-1)
    assert np.abs(change).sum() > 1e3 and abs(change.sum()) < 1e-7 * np.abs(change).sum()


def test_case_55_what_rivers_cut_is_laid_down_or_leaves():
    """Rivers without creep keep mass to 1e-6 of the change: eroded rock is deposited or leaves."""
    h = rough(83, 140)
    fixed = (h <= 0).reshape(-1)
    lift = np.where(fixed, 0, 3e-4 * np.random.default_rng(1).random(h.size)).astype(np.float32)
    part = np.random.default_rng(2).random(h.size).astype(np.float32)
    bed = bed_of(h, 12.0, 9.0, fixed=fixed, uplift=lift, weight=part)
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


@pytest.mark.thorough
def test_case_56_a_grown_range_converges():
    """Twice the samples give the same grown range to 2.5 % of its relief, and its mean height to 5 %."""
    fine = island(1025)
    uplift, spacing, ranges = np.full(fine.shape, 5e-4, np.float32), SIDE / 1024, {}
    for every in (1, 2):
        h = np.ascontiguousarray(fine[::every, ::every])
        ranges[every] = h + grow(h, uplift[::every, ::every], spacing * every, threads=2).heights
    difference, relief = ranges[1][::2, ::2] - ranges[2], ranges[1].max()
    assert relief > 300 and np.sqrt(np.mean(difference.astype(np.float64) ** 2)) < 0.025 * relief
    land = ranges[2] > 0
    assert abs(difference[land].mean()) < 0.05 * ranges[2][land].mean()


def test_case_57_a_tile_of_rivers_is_as_the_whole():
    """A tile with its halo and the inflow over its border equals the whole to 5 % of the level's change."""
    fine = island(513)
    spacing, values = SIDE / 512, RIVERS.defaults()
    whole = OperatorGround(fine, spacing, spacing, whole=fine.shape, seed=3)
    below = replace(whole, heights=coarser(fine), step_x=2 * spacing, step_y=2 * spacing, level=1)
    coarse = apply_by_levels(RIVERS, below, values)
    up = {k: finer(a, fine.shape) for k, a in (coarse.layers | coarse.state).items()}
    up = Change(finer(coarse.heights, fine.shape), {k: up[k] for k in coarse.layers}, {k: up[k] for k in coarse.state})
    full = RIVERS.apply(whole, values, up)
    halo = round(RIVERS.halo(values, spacing) / spacing)
    for row, column, side in ((211, 197, 64), (230, 239, 80)):
        cut = np.s_[row - halo : row + side + halo, column - halo : column + side + halo]
        tile = replace(whole, heights=np.ascontiguousarray(fine[cut]), first=(row - halo, column - halo))
        below = Change(up.heights[cut], *({k: a[cut] for k, a in of.items()} for of in (up.layers, up.state)))
        alone = RIVERS.apply(tile, values, below)
        inner = np.s_[halo:-halo, halo:-halo]
        error = (alone.heights - full.heights[cut])[inner].astype(np.float64)
        change = (full.heights - 0.5 * up.heights)[cut][inner]
        assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(change**2))
        for border in np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]:
            expected = np.where(tile.heights > 0, up.heights[cut], 0)[border]
            assert np.allclose(alone.heights[border], expected, atol=1e-3), "the coarser level's heights"


@pytest.mark.parametrize("shape", [(300, 411)])
def test_case_58_threads_change_no_bit_of_rivers_and_seeds_do(shape):
    """1, 2 and 3 threads give the same bytes of rivers; another seed gives others."""
    h, found = rough(*shape), []
    for threads in (1, 2, 3):
        change = aged(h, 15.0, threads=threads, seed=4)
        found.append([change.heights.tobytes(), *(change.layers[name].tobytes() for name in LAYERS)])
    assert found[0] == found[1] == found[2]
    assert aged(h, 15.0, seed=5).heights.tobytes() != found[0][0]
