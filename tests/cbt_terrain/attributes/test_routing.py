# SPDX-License-Identifier: GPL-3.0-or-later
"""Where water goes: against a flood by a heap and areas gathered sample by sample in numpy."""

import heapq
import itertools
import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.routing import route
from adaptive_terrain.kernels.effects.routing import ReceiverNoise

AROUND = [(a, b) for a, b in itertools.product((-1, 0, 1), repeat=2) if (a, b) != (0, 0)]


def flooded(h, holes):
    """Return the lowest surface that drains to the border or a hole: priority flood (Barnes et al. 2014)."""
    rows, columns = h.shape
    inner = np.zeros(h.shape, bool)
    inner[1:-1, 1:-1] = True
    known = ~(inner & ~holes)
    heights, level = h.tolist(), np.where(known, h, np.inf).tolist()
    waiting = [(heights[j][i], (j, i)) for j, i in np.argwhere(known).tolist()]
    heapq.heapify(waiting)
    while waiting:
        z, (j, i) = heapq.heappop(waiting)
        for a, b in AROUND:
            y, x = j + a, i + b
            if 0 <= y < rows and 0 <= x < columns and level[y][x] == math.inf:
                level[y][x] = max(heights[y][x], z)
                heapq.heappush(waiting, (level[y][x], (y, x)))
    return np.array(level)


def gathered(drainage, filled, step_x, step_y):
    """Accumulate drainage areas in float64, in shares; the receiver gets all where no neighbour is lower."""
    shape = filled.shape
    share = {(a, b): 0.5 * step_x * step_y / (a * a * step_y**2 + b * b * step_x**2) for a, b in AROUND}
    for b in (-1, 1):
        share[0, b], share[b, 0] = 0.5 * step_y / step_x, 0.5 * step_x / step_y
    z, to = filled.astype(np.float64).tolist(), drainage.to.reshape(shape).astype(int).tolist()
    area = np.ones(shape).tolist()
    rank = np.empty(filled.size, int)
    rank[drainage.order] = np.arange(filled.size)
    for at in np.lexsort((rank, -filled.astype(np.float64).ravel())).tolist():
        j, i = divmod(at, shape[1])
        if to[j][i] == 4:
            continue
        falls = {(a, b): max(z[j][i] - z[j + a][i + b], 0.0) * share[a, b] for a, b in AROUND}
        total = sum(falls.values())
        if total == 0.0:
            falls, total = {(to[j][i] // 3 - 1, to[j][i] % 3 - 1): 1.0}, 1.0
        for (a, b), fall in falls.items():
            area[j + a][i + b] += area[j][i] * fall / total
    return np.array(area)


def terrain(kind, rows=41, columns=57):
    rng = np.random.default_rng(4)
    y, x = np.indices((rows, columns))
    noise = rng.standard_normal((rows, columns))
    heights = {
        "noise": noise,
        "steps": np.round(2 * noise + x / 9),
        "plateau": np.minimum(np.hypot(y - 20, x - 28) * -1.0, -9.0),
        "level": np.zeros((rows, columns)),
        "bowl": np.hypot(y - 20, x - 28),
        "flat bowl": np.maximum(np.hypot(y - 20, x - 28), 8.0),
        "minus zero": np.where((x + y) % 2, 0.0, -0.0),
    }
    return heights[kind].astype(np.float32)


KINDS = ["noise", "steps", "plateau", "level", "bowl", "flat bowl", "minus zero"]


def holes_in(shape):
    holes = np.zeros(shape, bool)
    holes[12:15, 20:26] = True
    return holes


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("with_holes", [False, True])
def test_every_sample_drains_and_nothing_is_lost(kind, with_holes):
    """Hard case 54, plateaus: also where nothing falls."""
    h = terrain(kind)
    holes = holes_in(h.shape) if with_holes else np.zeros(h.shape, bool)
    drainage = route(h, 10.0, 7.0, holes)
    filled = drainage.filled()
    assert np.array_equal(filled.reshape(h.shape), flooded(h, holes)) and not np.signbit(filled[filled == 0.0]).any()
    rank = np.empty(h.size, int)
    rank[drainage.order] = np.arange(h.size)
    assert sorted(drainage.order) == list(range(h.size))
    at = np.flatnonzero(drainage.to != 4)
    direction = drainage.to[at].astype(int)
    receiver = at + (direction // 3 - 1) * h.shape[1] + direction % 3 - 1
    assert (rank[receiver] > rank[at]).all()
    assert np.array_equal(drainage.base == 1, drainage.to == 4), "no pit is left"
    before = drainage.order.copy()
    area = drainage.areas(filled)
    assert np.array_equal(drainage.order, before[np.argsort(-filled[before], kind="stable")])
    assert np.array_equal(drainage.filled(), filled), "donors are still before receivers"
    assert area[drainage.base == 1].sum() == pytest.approx(h.size, rel=1e-12)
    expected = gathered(drainage, filled.reshape(h.shape), 10.0, 7.0)
    assert np.allclose(area.reshape(h.shape), expected, rtol=1e-12)


def test_a_plateau_drains_along_the_shortest_ways():
    h = terrain("plateau")
    to = route(h, 1.0, 1.0).to.reshape(h.shape).astype(int)
    flat = h == -9.0
    away = np.where(flat, np.inf, 0.0)
    for _ in range(40):
        around = np.min([np.roll(away, at, (0, 1)) for at in AROUND], axis=0)
        away[1:-1, 1:-1] = np.minimum(away, around + 1)[1:-1, 1:-1]
    # The last step leaves the edge, which is as high as the plateau, next to lower ground.
    for start in np.argwhere(flat):
        (j, i), steps = start, 0
        while flat[j, i]:
            j, i, steps = j + to[j, i] // 3 - 1, i + to[j, i] % 3 - 1, steps + 1
        assert steps == away[tuple(start)]


def test_a_cone_drains_alike_on_all_sides():
    y, x = np.indices((65, 65)) - 32.0
    drainage = route((-np.hypot(x, y)).astype(np.float32), 5.0, 5.0)
    area = drainage.areas(drainage.filled()).reshape(65, 65)
    for other in (area.T, area[::-1], area[:, ::-1]):
        assert np.allclose(area, other, rtol=1e-9)
    # Half the distance from the summit drains through a metre of contour, and half a sample is the last one's own.
    assert area[32, [40, 48, 56]] == pytest.approx(np.array([9, 17, 25]) / 2, rel=0.04)


def test_a_plane_carries_as_much_as_lies_above():
    y, x = np.indices((41, 201))
    drainage = route((-0.3 * x).astype(np.float32), 10.0, 10.0)
    area = drainage.areas(drainage.filled()).reshape(41, 201)
    # What the upper rim has falls out of the raster, and so does what crosses the sides.
    assert area[20, 1:20] == pytest.approx(np.arange(1, 20))


def test_a_lake_has_the_area_of_its_outlet():
    h = terrain("bowl")
    h[20, 40:] = np.arange(17) * -0.1 + 5.0  # a gorge: the outlet, 5 m above the ground
    drainage = route(h, 10.0, 10.0)
    filled = drainage.filled()
    area = drainage.areas(filled)
    before = area.copy()
    drainage.level_lakes(filled, area)
    lake = filled > drainage.heights
    assert lake.sum() > 40 and (area[lake] == area[lake].max()).all()
    assert area[lake].max() > 0.9 * (h.size - 200) / 2 and np.array_equal(area[~lake], before[~lake])


def test_threads_change_no_bit():
    h = terrain("steps", 300, 420)
    found = []
    for threads in (1, 2, 3):
        drainage = route(h, 10.0, 12.0, holes_in(h.shape), threads)
        found.append((drainage.to.tobytes(), drainage.order.tobytes(), drainage.areas(drainage.filled()).tobytes()))
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize(
    ("steps", "most", "rms"), [((8, 8), 1.6, 1.1), ((10, 8), 2.6, 1.6), ((6, 12), 7.5, 3.7), ((15, 5), 12.0, 6.0)]
)
def test_with_noise_the_mean_path_down_a_plane_is_its_fall(steps, most, rms):
    """In degrees, over planes of any direction: at most 3.4 on square cells if diagonals counted fully;
    on other cells 7, 19 and 28 if steps along both axes counted alike. Without noise it would be up to 22."""
    y, x = np.indices((200, 200)) * np.array(steps)[::-1, None, None]
    off = []
    for degrees in range(4, 360, 11):
        turn, draw = np.radians(degrees), ReceiverNoise()
        plane = (1e4 - 0.6 * (np.cos(turn) * x + np.sin(turn) * y)).astype(np.float32)
        draw.jitter, draw.seed = 1.6, degrees
        to = route(plane, *steps, noise=draw).to.reshape(plane.shape)[1:-1, 1:-1].astype(int)
        mean = np.degrees(np.arctan2((to // 3 - 1).mean() * steps[1], (to % 3 - 1).mean() * steps[0]))
        off.append((mean - degrees + 180) % 360 - 180)
    assert np.abs(off).max() < most and np.sqrt(np.mean(np.square(off))) < rms
