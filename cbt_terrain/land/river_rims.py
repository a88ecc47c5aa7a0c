# SPDX-License-Identifier: GPL-3.0-or-later
"""What rivers do along the rim of a level, and along the cut of a tile, where the coarser level knows the way on.

A tile cannot know what comes over its cut, nor whether a lake that the cut runs through has its outlet in it or beyond.
The coarser level does: it gives the area that enters, and the water's surface along the cut, or that none leaves there.
"""

from collections.abc import Callable

import numpy as np

from ..effects.routing import route
from .fluvial import Bed
from .land_effect import Change, Ground
from .levels import finer

# Metres above a lake's surface that its water would have to rise to leave over a cut over which it comes in.
WALL = 1e4
SAME = 0.01
ROUGH = 4.0


def sides(shape: tuple[int, int]) -> list[tuple]:
    """South, north, west and east."""
    return [np.s_[0], np.s_[shape[0] - 1], np.s_[:, 0], np.s_[:, shape[1] - 1]]


def edges(bed: Bed, origin: np.ndarray, coarser: Change | None) -> Callable[[float], None]:
    """What moves the samples along the four sides, where water leaves, given the part of the steps that is done.

    At the coarsest level they fall with the sample inside them, so that a rim is no dam, but not below their lowest,
    which is the land's base level; they never rise. At finer ones they go the coarser level's way.
    """
    (rows, columns), side = bed.shape, np.zeros(bed.shape, bool)
    for which in sides(bed.shape):
        side[which] = True
    side &= ~bed.fixed.reshape(bed.shape)
    j, i = np.nonzero(side)
    at = j * columns + i
    if not len(at):
        return lambda _done: None
    if coarser is not None:
        start = bed.heights[at]
        way = origin[at] + coarser.heights.reshape(-1)[at] - start

        def follow(done: float) -> None:
            bed.heights[at] = start + way * np.float32(done)

        return follow
    inner = np.clip(j, 1, max(rows - 2, 0)) * columns + np.clip(i, 1, max(columns - 2, 0))
    lowest = origin[at].min()

    def fall(_done: float) -> None:
        change = np.minimum(bed.heights[inner] - origin[inner], np.float32(0.0))
        bed.heights[at] = np.maximum(origin[at] + change, lowest)

    return fall


def cut_of(ground: Ground, coarser: Change, less: float):
    """float64 [rows, columns]: samples that each counts for; those just inside a cut, with what comes over it. And what
    gives the water along the cut: see `_levels`.

    The samples of the coarser level are every second one, and where their water runs is known from their surface but
    at the first, whose neighbours are cut off: what runs from the second to the third brings its catchment along. In a
    lake that shows in the catchments alone, which grow along a path.
    """
    rows, columns = ground.heights.shape
    own = np.ones((rows, columns))
    if all(ground.rims):
        return own, None, None
    every = tuple(slice(f % 2, None, 2) for f in ground.first)
    lake = coarser.layers["lake"][every]
    heights = (ground.heights + coarser.heights)[every]
    surface = np.ascontiguousarray(heights + lake)
    before = (ground.heights + np.float32(less) * coarser.heights + coarser.layers["lake_before"])[every]
    wet = (lake > 0.0) | (coarser.layers["lake_before"][every] > 0.0)
    missing = None if ground.missing is None else ground.missing[every]
    to = route(surface, 2 * ground.step_x, 2 * ground.step_y, missing).to.reshape(heights.shape)
    flow = coarser.layers["flow"][every].astype(np.float64) / (ground.step_x * ground.step_y)
    inside = np.zeros(heights.shape, bool)
    south, north, west, east = (0 if rim else 2 for rim in ground.rims)
    inside[south : heights.shape[0] - north, west : heights.shape[1] - east] = True
    j, i = np.nonzero(~inside & (to != 4) & ~wet)
    direction = to[j, i].astype(int)
    y, x = j + direction // 3 - 1, i + direction % 3 - 1
    enters = inside[y, x]
    fine_y, fine_x = (2 * at + f % 2 for at, f in zip((y, x), ground.first, strict=True))
    np.add.at(own, (fine_y[enters], fine_x[enters]), flow[j, i][enters])
    load = np.zeros((rows, columns))
    brought = coarser.layers["load"][every].astype(np.float64) / (ground.step_x * ground.step_y)
    np.add.at(load, (fine_y[enters], fine_x[enters]), brought[j, i][enters])
    floor = route(np.ascontiguousarray(heights), 2 * ground.step_x, 2 * ground.step_y, missing).to.reshape(heights.shape)
    j, i = np.nonzero(~inside & (floor != 4) & wet)
    direction = floor[j, i].astype(int)
    y, x = j + direction // 3 - 1, i + direction % 3 - 1
    ok = inside[y, x] & (flow[y, x] > flow[j, i])
    done = np.zeros(heights.shape, bool)
    done[j[ok], i[ok]] = True
    fine_y, fine_x = (2 * at + f % 2 for at, f in zip((y, x), ground.first, strict=True))
    np.add.at(own, (fine_y[ok], fine_x[ok]), flow[j, i][ok])
    np.add.at(load, (fine_y[ok], fine_x[ok]), brought[j, i][ok])
    # lakes
    state = np.zeros(heights.shape, np.uint8)  # 1 open 2 wall
    jj, ii = np.indices(to.shape)
    dest = ((jj + to.astype(int) // 3 - 1) * to.shape[1] + ii + to.astype(int) % 3 - 1).reshape(-1)
    dest[inside.reshape(-1)] = np.flatnonzero(inside.reshape(-1))
    for _ in range(12):
        dest = dest[dest]
    state[inside.reshape(-1)[dest].reshape(to.shape) & ~wet] = 2
    ring, valid = _ring(heights.shape, ground.rims)
    rj, ri = ring
    w = np.flatnonzero(wet[rj, ri] & valid)
    if len(w):
        w = w[np.argsort(surface[rj[w], ri[w]], kind="stable")]
        lakes = np.split(w, np.flatnonzero(np.diff(surface[rj[w], ri[w]]) > SAME) + 1)
        inner = np.where(inside, flow, -1.0)
        for at in lakes:
            top = at[np.argmax(flow[rj[at], ri[at]])]
            a, b = rj[top], ri[top]
            near = [(y, x) for y in range(max(a - 1, 0), min(a + 2, inside.shape[0])) for x in range(max(b - 1, 0), min(b + 2, inside.shape[1]))]
            best = max(near, key=lambda p: inner[p])
            state[rj[at], ri[at]] = 2
            if inner[best] <= flow[a, b]:
                state[a, b] = 1
            elif not done[a, b]:
                load[2 * best[0] + ground.first[0] % 2, 2 * best[1] + ground.first[1] % 2] += brought[a, b]
                own[2 * best[0] + ground.first[0] % 2, 2 * best[1] + ground.first[1] % 2] += flow[a, b]
    low = [f % 2 for f in ground.first]
    part = ground.heights[low[0]:, low[1]:]
    part = part[: len(part) - 1 + len(part) % 2, : part.shape[1] - 1 + part.shape[1] % 2]
    rough = part - finer(np.ascontiguousarray(part[::2, ::2]), part.shape)
    rough = ROUGH * float(np.sqrt(np.mean(np.square(rough, dtype=np.float64))))
    top, kind, area = np.maximum(surface, before)[rj, ri], state[rj, ri], flow[rj, ri]
    lev = np.where(kind == 2, top, -np.inf); fl = np.where(kind == 2, area, 0.0)
    n = len(top)
    for order in (range(2 * n), range(2 * n, 0, -1)):
        step = order.step
        for q in order:
            a, b = q % n, (q - step) % n
            if kind[b] == 2 and lev[b] + rough > top[a] and area[a] < fl[b] and kind[a] != 1 and valid[a]:
                if kind[a] != 2:
                    kind[a] = 2; lev[a] = lev[b]; fl[a] = fl[b]
                elif fl[b] > fl[a] and lev[b] > lev[a]:
                    lev[a] = lev[b]; fl[a] = fl[b]
    state[rj, ri] = kind
    # fine rim
    side = np.zeros((rows, columns), bool)
    for which, rim in zip(sides((rows, columns)), ground.rims, strict=True):
        if not rim:
            side[which] = True
    j, i = np.nonzero(side)
    r0, r1, c0, c1 = _box(heights.shape, ground.rims)
    cj = np.clip((j - ground.first[0] % 2 + 1) // 2, r0, r1)
    ci = np.clip((i - ground.first[1] % 2 + 1) // 2, c0, c1)
    s = state[cj, ci]
    keep = s > 0
    at = (j * columns + i)[keep]
    wall = np.where(s[keep] == 2, np.float32(WALL), np.float32(0.0))
    start, end = before[cj, ci][keep], surface[cj, ci][keep]
    return own, (at, wall, start, end), load.reshape(-1)


def _box(shape, rims):
    south, north, west, east = (0 if rim else 1 for rim in rims)
    return south, shape[0] - 1 - north, west, shape[1] - 1 - east


def _ring(shape, rims):
    r0, r1, c0, c1 = _box(shape, rims)
    rr, cc = np.arange(r0, r1), np.arange(c0, c1)
    south, north, west, east = rims
    j = np.concatenate([np.full(len(cc), r0), rr, np.full(len(cc), r1), rr[::-1] + 1])
    i = np.concatenate([cc, np.full(len(rr), c1), cc[::-1] + 1, np.full(len(rr), c0)])
    valid = np.concatenate([np.full(len(cc), not south), np.full(len(rr), not east), np.full(len(cc), not north), np.full(len(rr), not west)])
    return (j, i), valid
