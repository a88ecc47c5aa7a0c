# SPDX-License-Identifier: GPL-3.0-or-later
"""The loops of rivers in C, against the same in numpy and Python: the same bits."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.attributes.routing import route
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import flat
from adaptive_terrain.kernels.land import creep, fluvial

F, D = np.float32, np.float64
STEPS = 12.0, 7.0


@pytest.fixture(scope="module")
def case():
    """Return drained noise with basins, and random arrays for the inputs of the loops."""
    rng = np.random.default_rng(8)
    shape = (53, 121)
    h = (30 * rng.standard_normal(shape) + np.indices(shape)[0] * 2).astype(F)
    drainage = route(h, *STEPS, cell_weight=np.ones(shape))
    found = {name: rng.random(h.size).astype(F) for name in ("weight", "erodibility", "rate")}
    found["weight"][::7], found["rate"][::11] = 0.0, 0.0
    found["rate"] *= F(30)
    return drainage, h.reshape(-1), found


def river(drainage, found, **arrays):
    r = fluvial.River()
    r.grid, r.to, r.order = drainage.grid, flat(drainage.to, wp.uint8), flat(drainage.order, wp.int32)
    r.area = flat(drainage.catchments, wp.float64)
    return with_arrays(r, **{"weight": found["weight"], "rate": found["rate"]} | arrays)


def soil(drainage, found, **arrays):
    s = creep.Soil()
    s.grid, s.base = drainage.grid, flat(drainage.base, wp.uint8)
    return with_arrays(s, weight=found["weight"], **arrays)


def with_arrays(struct, **arrays):
    for name, array in arrays.items():
        setattr(struct, name, flat(array, wp.float32))
    return struct


def receivers(drainage):
    to = drainage.to.astype(int)
    return np.arange(len(to)) + (to // 3 - 1) * drainage.grid.width + to % 3 - 1


def test_rates_are_those_of_numpy(case):
    drainage, h, found = case
    made, shape = np.empty_like(h), (53, 121)
    r = river(drainage, found, erodibility=found["erodibility"], rate=made)
    r.cell, r.hillslope, r.strength = 84.0, 5e3, 0.08
    launch.spread(fluvial.find_rates, shape[0], [r], step="test")
    axis = np.where(drainage.to % 2 == 0, 2, np.where((drainage.to == 3) | (drainage.to == 5), 0, 1))
    near = np.array([*drainage.grid.inverse_distance], F)[axis]
    area = drainage.catchments.astype(F) * F(84.0) + F(5e3)
    assert np.array_equal(made, np.sqrt(area) * near * found["erodibility"] * F(0.08))


def test_the_cut_is_that_of_a_loop_in_single_precision(case):
    drainage, h, found = case
    made, filled, drop = h.copy(), np.empty_like(h), np.array([8.0, 5.0, 9.0], F)
    r = river(drainage, found, filled=filled, h=made)
    r.drop, r.lakes = wp.vec3f(*drop), 1
    launch.once(fluvial.cut_down, [r], step="test")
    z, water, to, other = h.copy(), h.copy(), drainage.to, receivers(drainage)
    for i in drainage.order[::-1]:
        j, rate = other[i], found["rate"][i]
        if to[i] != 4 and z[i] > z[j] and rate > 0:
            v = z[j] + (z[i] - z[j]) / (F(1) + rate)
            top = z[j] + drop[2 if to[i] % 2 == 0 else 0 if to[i] in (3, 5) else 1]
            z[i] = v - max(v - top, F(0)) * found["weight"][i]
        water[i] = z[i] if to[i] == 4 else max(z[i], water[j])
    assert np.array_equal(made, z) and (z != h).mean() > 0.3
    assert np.array_equal(filled, water) and (water > z).any()
    untouched = h.copy()
    r.lakes, r.filled, r.h = 0, flat(np.full_like(h, 7.0), wp.float32), flat(untouched, wp.float32)
    launch.once(fluvial.cut_down, [r], step="test")
    assert np.array_equal(untouched, z)


def test_creep_is_that_of_numpy(case):
    drainage, h, found = case
    made, kept = h.copy(), (F(5) * np.random.default_rng(4).standard_normal(len(h))).astype(F)
    s = soil(drainage, found, preserved=kept, old=h, h=made)
    s.ew, s.ns = 0.2, 0.11
    launch.spread(creep.creep, 51, [s], step="test", threads=3)
    z, inner = h.reshape(53, 121), np.s_[1:-1, 1:-1]
    twice = z + z
    u = (z[1:-1, :-2] + z[1:-1, 2:] - twice[inner]) * F(0.2)
    v = (z[:-2, 1:-1] + z[2:, 1:-1] - twice[inner]) * F(0.11)
    k = kept.reshape(z.shape)[inner]
    stays = np.clip(u + v, np.minimum(k, F(0)), np.maximum(k, F(0)))
    expected = z.copy()
    expected[inner] += ((u + v) - stays) * found["weight"].reshape(z.shape)[inner]
    assert np.array_equal(made.reshape(z.shape), expected)


def test_far_creep_solves_its_equations(case):
    """Solve along the columns, then along the rows; the result satisfies the equations of both."""
    drainage, h, found = case
    z, part, fixed = h.copy(), found["weight"], drainage.base.reshape(53, 121) == 1
    s = soil(drainage, found, scratch=np.empty_like(h), change=np.empty_like(h), h=z)
    s.ew, s.ns = 11.0, 7.0

    def residual(kernel, count, inputs, ratio, axis):
        before = z.reshape(53, 121).astype(D)
        launch.spread(kernel, count, [*inputs, s], step="test", threads=3, cost=1e9)
        u = z.reshape(53, 121).astype(D)
        bend = 2 * u - np.roll(u, 1, axis) - np.roll(u, -1, axis)
        given = u + np.where(fixed, 0, part.reshape(u.shape) * D(F(ratio)) * bend)
        return np.abs(given - before).max()

    assert residual(creep.creep_along_columns, 2, [64], 7.0, 0) < 1e-3
    assert residual(creep.creep_along_rows, 53, [], 11.0, 1) < 1e-3
    assert np.array_equal(z[drainage.base == 1], h[drainage.base == 1]) and np.ptp(z) < np.ptp(h)


def test_sediment_is_that_of_a_loop_in_double_precision(case):
    drainage, before, found = case
    h = before - F(4) * np.random.default_rng(2).random(len(before)).astype(F)
    made, load, filled = h.copy(), np.zeros(len(h)), np.maximum(drainage.filled() - F(5), h)
    r = river(drainage, found, raised=before, filled=filled, h=made)
    r.deposition, r.load = 1.7, flat(load, wp.float64)
    launch.once(fluvial.deposit, [r], step="test")
    z, carried, other = h.copy(), np.zeros(len(h)), receivers(drainage)
    for i in drainage.order:
        if drainage.to[i] == 4:
            continue
        most, cut = max(carried[i], 0.0), D(before[i]) - D(z[i])
        displaced = min(most, 0.25 * (D(filled[i]) - D(z[i])))
        if filled[i] <= z[i]:
            displaced = most * min(1.7 / drainage.catchments[i], 1.0)
            displaced = min(displaced, 0.5 * max(cut, 0.0) + 0.05 * most) / (1.0 + D(found["rate"][i]))
        z[i] = F(D(z[i]) + displaced * D(found["weight"][i]))
        carried[other[i]] += carried[i] + (D(before[i]) - D(z[i]))
    assert np.array_equal(made, z) and np.array_equal(load, carried) and (z != h).mean() > 0.3


def settled(sediment, heights, water, apart):
    """Return the sediment after a pass of settling under water, all [rows, columns]."""
    sums = []
    for axis in (1, 0):
        sides = []
        for by in (apart, -apart):
            other, there, wet = (np.roll(a, by, axis) for a in (sediment, heights, water))
            v = np.clip((there - heights) * F(0.2), F(-0.2) * sediment, F(0.2) * other)
            sides.append(np.where(water & wet, v, F(0)))
        sums.append(sides[0] + sides[1])
    return sediment + (sums[0] + sums[1])


@pytest.mark.parametrize("apart", [1, 4])
def test_settling_is_that_of_numpy_and_keeps_all(case, apart):
    drainage, rock, _ = case
    rng, shape = np.random.default_rng(4), (53, 121)
    inner = np.zeros(shape, bool)
    inner[apart:-apart, apart:-apart] = True
    lake = ((drainage.filled() > rock) & inner.reshape(-1)).astype(np.uint8)
    old = np.where(rng.random(rock.size) < 0.7, 9 * rng.random(rock.size), 0).astype(F)
    made, scratch = old.copy(), old.copy()
    rows = np.flatnonzero(lake.reshape(shape).any(axis=1)).astype(np.int32)
    ends = [flat((121 * rows + at).astype(np.int32), wp.int32) for at in (apart, 120 - apart)]
    arrays = [flat(lake, wp.uint8), *(flat(a, wp.float32) for a in (rock, made, scratch))]
    launch.once(fluvial.settle, [2, 121, apart, *ends, *arrays], step="test")
    s, water = old.reshape(shape), lake.reshape(shape) == 1
    for _ in range(4):
        s = settled(s, rock.reshape(shape) + s, water, apart)
    assert 0.2 < water.mean() < 0.8 and np.array_equal(made.reshape(shape), s)
    assert np.array_equal(made[lake == 0], old[lake == 0]) and made.min() >= 0
    assert abs(made.sum(dtype=D) - old.sum(dtype=D)) < 1e-7 * old.sum() and np.abs(made - old).max() > 0.5
