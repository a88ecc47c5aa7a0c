# SPDX-License-Identifier: GPL-3.0-or-later
"""The loops of routing in C, against the same in numpy and Python: the same bits."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.attributes.routing import grid_of
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import flat
from adaptive_terrain.kernels.effects import routing, rows

F, U = np.float32, np.uint32
DIRECTIONS = [k for k in range(9) if k != 4]


def scrambled(a):
    a = (a ^ (a >> U(16))) * U(0x7FEB352D)
    a = (a ^ (a >> U(15))) * U(0x846CA68B)
    return a ^ (a >> U(16))


def noise(shape, draw):
    """Return the noise by direction, 1 - jitter / 2 .. 1 + jitter / 2, float32 [rows, columns]."""
    y, x = np.indices(shape).astype(U)
    with np.errstate(over="ignore"):
        a = scrambled(scrambled(y + U(draw.row) + U(draw.seed)) + U(draw.column) + x)
        b = (a ^ (a >> U(15))) * U(0x2C1B3C6D)
        b = b ^ (b >> U(16))
    byte = [(word >> U(8 * q)) & U(255) for word in (a, b) for q in range(4)]
    least = F(1) - F(draw.jitter) * F(0.498046875)
    step = F(draw.jitter) * F(0.00390625)
    return {k: least + byte[q].astype(F) * step for q, k in enumerate(DIRECTIONS)}


def found(h, base, steps, draw, threads):
    to, d = np.empty(h.size, np.uint8), rows.DrainageArrays()
    d.grid = grid_of(*h.shape, *steps)
    d.h, d.base, d.to = flat(h, wp.float32), flat(base, wp.uint8), flat(to, wp.uint8)
    inputs = [d, d.grid.inverse_distance, draw]
    launch.spread(routing.find_receivers, h.shape[0], inputs, step="test", threads=threads, cost=1e9)
    return to.reshape(h.shape), d


@pytest.mark.parametrize("jitter", [0.0, 1.6])
@pytest.mark.parametrize("shape", [(3, 3), (40, 67), (31, 200)])
def test_receivers_are_those_of_numpy(jitter, shape):
    rng, draw = np.random.default_rng(6), routing.ReceiverNoise()
    draw.jitter, draw.seed, draw.row, draw.column = jitter, 0xDEADBEEF, 1000, 77
    h = np.round(9 * rng.standard_normal(shape), 1).astype(F)
    base = (rng.random(shape) < 0.05).astype(np.uint8)
    to, d = found(h, base, (10.0, 7.0), draw, 3)
    near, factor = np.array([*d.grid.inverse_distance], F), noise(shape, draw)
    best, expected = np.zeros(shape, F), np.full(shape, 4, np.uint8)
    inner = np.s_[1:-1, 1:-1]
    for k in DIRECTIONS:
        j, i = k // 3 - 1, k % 3 - 1
        fall = np.zeros(shape, F)
        lower = h[1 + j : h.shape[0] - 1 + j, 1 + i : h.shape[1] - 1 + i]
        fall[inner] = (h[inner] - lower) * near[2 if k % 2 == 0 else 0 if k in (3, 5) else 1]
        if jitter:
            fall *= factor[k]
        better = fall > best
        best[better], expected[better] = fall[better], k
    expected[base == 1] = 4
    assert np.array_equal(to, expected)


def test_noise_has_the_mean_one_and_is_of_the_place():
    draw = routing.ReceiverNoise()
    draw.jitter, draw.seed = 1.6, 5
    factors = noise((200, 200), draw)
    for factor in factors.values():
        assert abs(factor.mean() - 1) < 0.01 and factor.min() > 0.19 and factor.max() < 1.81
    draw.row, draw.column = 50, 30
    assert np.array_equal(noise((9, 9), draw)[5], factors[5][50:59, 30:39])


def test_donors_basins_and_passes_are_those_of_plain_loops():
    rng = np.random.default_rng(9)
    shape = height, columns = 37, 150
    h = rng.standard_normal(shape).astype(F)
    h[10:20, 20:100] = np.indices((10, 80))[1] * F(0.01)  # one large basin: blocks without a pass
    h[30:, :50] = rng.choice(np.array([0.0, -0.0, 0.5, -0.5], F), (7, 50))  # passes of one height
    base = np.zeros(shape, np.uint8)
    to, d = found(h, base, (1.0, 1.0), routing.ReceiverNoise(), 1)
    donors = np.empty(h.size, np.uint8)
    d.donors = flat(donors, wp.uint8)
    launch.spread(routing.count_donors, height, [d], step="test")
    receiver = np.arange(h.size) + ((to // 3).astype(int) - 1).ravel() * columns + (to % 3).astype(int).ravel() - 1
    flows = to.ravel() != 4
    assert np.array_equal(donors, np.bincount(receiver[flows], minlength=h.size))
    base[[0, -1]], base[:, [0, -1]] = 1, 1
    label, pits = np.zeros(h.size, np.int32), np.zeros(1, np.int32)
    d.label, d.order = flat(label, wp.int32), flat(np.empty_like(label), wp.int32)
    launch.once(routing.cross_flats, [d, flat(pits, wp.int32)], step="test")
    receiver = np.arange(h.size) + ((to // 3).astype(int) - 1).ravel() * columns + (to % 3).astype(int).ravel() - 1
    expected = np.where((to == 4) & (base == 1), 1, 0).ravel()
    expected[(to == 4).ravel() & (base == 0).ravel()] = np.arange(2, pits[0] + 2)
    launch.spread(routing.label_basins, -(-h.size // 500), [500, d], step="test", threads=3, cost=1e9)
    for _ in range(200):
        expected = np.where(expected > 0, expected, expected[receiver])
    assert np.array_equal(label, expected) and pits[0] > 100
    basin = label.reshape(shape)
    edges = []
    for y in range(height - 1):
        for x in range(columns):
            for q, (j, i) in enumerate(((0, 1), (1, -1), (1, 0), (1, 1))):
                if 0 <= x + i < columns and basin[y, x] != basin[y + j, x + i]:
                    edges.append((max(h[y, x], h[y + j, x + i]), (y * columns + x) * 4 + q))
    start = np.zeros(height + 1, np.int64)
    edge = np.empty(len(edges), np.int32)
    arrays = [d, flat(start, wp.int64), flat(edge, wp.int32)]
    launch.spread(routing.find_passes, height - 1, [0, *arrays], step="test")
    start[1:] = np.cumsum(start[:-1])
    start[0] = 0
    assert start[-1] == len(edges)
    launch.spread(routing.find_passes, height - 1, [1, *arrays], step="test", threads=2, cost=1e9)
    assert list(edge) == [number for _, number in edges]
    halves, starts = np.empty(len(edges), np.uint16), np.zeros(2 << 16, np.int32)
    scratch = [flat(np.empty_like(edge), wp.int32), flat(halves, wp.uint16), flat(starts, wp.int32)]
    launch.once(routing.sort_passes, [len(edges), d, flat(edge, wp.int32), *scratch], step="test")
    assert list(edge) == [number for _, number in sorted(edges)]
