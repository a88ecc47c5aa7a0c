# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivers along the rim of a level, where water leaves, and along the cut of a tile, where the coarser level knows more.

A tile cannot know what comes over its cut, nor whether a lake that the cut runs through has its outlet in the tile or
beyond. The coarser level does: from its water's surface and catchments follows where water comes in, with how much
sediment; there none leaves. Without that a lake would leave over the lowest sample of the cut.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..effects.routing import route
from .fluvial import Bed
from .land_effect import Change, Ground
from .levels import finer

# What the next finer level is told beside the layers: m, and m3 of sediment that come to a sample in a year.
LAKE, LOAD = "lake", "load"
# Metres that water would have to rise to leave where it comes in.
WALL = 1e4
# Surfaces of a lake differ by less, metres: by rounding, and where tiles of the coarser level meet.
LEVEL = 0.01
# Of the root mean square by which a level is rougher than the coarser one: lakes may stand so much higher in it.
ROUGHNESS = 4.0


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


@dataclass(frozen=True, eq=False)
class _Seen:
    """The coarser level at its samples in a tile, which are every second one; arrays are [rows, columns] of them.

    `odd`: row and column of the first. `surface`: float32 m, of ground and lakes. `flow`: float64, fine samples that
    drain through each; `load`: float64, metres of sediment times fine samples a year. `wet`: bool, lakes. `inside`:
    bool: the outermost two samples along a cut are not, since of the first nobody knows where its water runs. `to`:
    where it runs, by the surface, and on the floors of lakes by the floor.
    """

    odd: tuple[int, int]
    surface: np.ndarray
    flow: np.ndarray
    load: np.ndarray
    wet: np.ndarray
    inside: np.ndarray
    to: np.ndarray

    def receivers(self) -> tuple[np.ndarray, np.ndarray]:
        j, i = np.indices(self.to.shape)
        return j + self.to // 3 - 1, i + self.to % 3 - 1


@dataclass(frozen=True, eq=False)
class _Ring:
    """The outermost samples of the coarser level whose water's way is known, once around a tile; arrays [samples].

    `at`: rows and columns. `cut`: bool, not along the raster's own rim. `shut`: bool, none leaves here.
    """

    at: tuple[np.ndarray, np.ndarray]
    cut: np.ndarray
    shut: np.ndarray


def take_over(bed: Bed, ground: Ground, coarser: Change) -> None:
    """Give the bed of a tile what comes over its cut, and what water has to rise to, to leave there."""
    if all(ground.rims):
        return
    seen = _seen(bed, ground, coarser)
    own, load = np.ones(bed.shape), np.zeros(bed.shape)

    def bring(j, i, y, x) -> None:
        fine = 2 * y + seen.odd[0], 2 * x + seen.odd[1]
        np.add.at(own, fine, seen.flow[j, i])
        np.add.at(load, fine, seen.load[j, i])

    y, x = seen.receivers()
    enters = ~seen.inside & (seen.to != 4) & seen.inside[y, x]
    enters &= ~seen.wet | (seen.flow[y, x] > seen.flow)  # the way over a floor may be turned around, to the outlet
    bring(*np.nonzero(enters), y[enters], x[enters])
    ring = _ring(seen, ground)
    for lake in _lakes(seen, ring):
        ring.shut[lake] = True
        j, i = (n[lake[np.argmax(seen.flow[ring.at][lake])]] for n in ring.at)
        south, west = max(j - 1, 0), max(i - 1, 0)
        near = np.where(seen.inside, seen.flow, -1.0)[south : j + 2, west : i + 2]
        at = np.unravel_index(near.argmax(), near.shape)
        if near[at] <= seen.flow[j, i]:  # catchments grow along a path: this one leaves the tile
            ring.shut[(ring.at[0] == j) & (ring.at[1] == i)] = False
        elif not enters[j, i]:
            bring(j, i, south + at[0], west + at[1])
    _shut_beside(ring, seen, ROUGHNESS * _roughness(ground, seen.odd))
    bed.own, bed.brought = own.reshape(-1), load.reshape(-1)
    bed.rim, bed.spill = _spills(bed, ground, seen, ring)


def _seen(bed: Bed, ground: Ground, coarser: Change) -> _Seen:
    odd = tuple(first % 2 for first in ground.first)
    every, per = tuple(slice(n, None, 2) for n in odd), 1.0 / (ground.step_x * ground.step_y)
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[every])
    lake, fixed = coarser.kept[LAKE][every], bed.fixed.reshape(bed.shape)[every]
    surface, wet = floor + lake, lake > 0.0
    steps = 2 * ground.step_x, 2 * ground.step_y
    ways = (route(heights, *steps, fixed, ground.threads).to.reshape(floor.shape) for heights in (surface, floor))
    inside = np.zeros(floor.shape, bool)
    south, north, west, east = (0 if rim else 2 for rim in ground.rims)
    inside[south : len(floor) - north, west : floor.shape[1] - east] = True
    sums = ((array[every] * per).astype(np.float64) for array in (coarser.layers["flow"], coarser.kept[LOAD]))
    return _Seen(odd, surface, *sums, wet, inside, np.where(wet, *reversed([*ways])).astype(int))


def _ring(seen: _Seen, ground: Ground) -> _Ring:
    """Shut where the water of the sample flows into the tile, but for lakes."""
    (rows, columns), (south, north, west, east) = seen.to.shape, ground.rims
    low, high = 1 - south, rows - 2 + north
    left, right = 1 - west, columns - 2 + east
    up, along = np.arange(low, high), np.arange(left, right)
    j = np.concatenate([np.full(len(along), low), up, np.full(len(along), high), up[::-1] + 1])
    i = np.concatenate([along, np.full(len(up), right), along[::-1] + 1, np.full(len(up), left)])
    cut = np.repeat([not south, not east, not north, not west], [len(along), len(up)] * 2)
    y, x = seen.receivers()
    down, stays = (y * columns + x).reshape(-1), np.arange(rows * columns)
    down = np.where(seen.inside.reshape(-1), stays, down)
    for _ in range(4):  # 16 samples along the ring
        down = down[down]
    into = seen.inside.reshape(-1)[down].reshape(rows, columns) & ~seen.wet
    return _Ring((j, i), cut, into[j, i] & cut)


def _lakes(seen: _Seen, ring: _Ring) -> list[np.ndarray]:
    """Places in the ring of each lake that it runs through: of all those whose water stands alike."""
    at = np.flatnonzero(seen.wet[ring.at] & ring.cut)
    level = seen.surface[ring.at][at]
    order = np.argsort(level, kind="stable")
    return [] if not len(at) else np.split(at[order], np.flatnonzero(np.diff(level[order]) > LEVEL) + 1)


def _roughness(ground: Ground, odd: tuple[int, int]) -> float:
    """Root mean square of what the samples of a level tell of the heights beside every second one, metres."""
    part = ground.heights[odd[0] :, odd[1] :]
    rows, columns = (n - 1 + n % 2 for n in part.shape)
    part = part[:rows, :columns]
    rough = part - finer(np.ascontiguousarray(part[::2, ::2]), part.shape)
    return float(np.sqrt(np.mean(np.square(rough, dtype=np.float64))))


def _shut_beside(ring: _Ring, seen: _Seen, higher: float) -> None:
    """Shut what lies beside shut places and less than so much higher, since finer ground may dam what comes in; but not
    where more water leaves than comes in there."""
    surface, flow, cut = (a.tolist() for a in (seen.surface[ring.at], seen.flow[ring.at], ring.cut))
    shut, wet = ring.shut.tolist(), seen.wet[ring.at].tolist()
    level, most = ([a if s else 0.0 for a, s in zip(of, shut, strict=True)] for of in (surface, flow))
    n = len(shut)
    for step in (1, -1):
        for q in range(2 * n):
            at, back = step * q % n, step * (q - 1) % n
            if not (shut[back] and cut[at] and surface[at] < level[back] + higher and flow[at] < most[back]):
                continue
            if not shut[at] and not wet[at]:
                shut[at], level[at], most[at] = True, level[back], most[back]
            elif shut[at] and level[back] > level[at]:
                level[at], most[at] = level[back], most[back]
    ring.shut[:] = shut


def _spills(bed: Bed, ground: Ground, seen: _Seen, ring: _Ring) -> tuple[np.ndarray, np.ndarray]:
    """The samples along the cut, and metres to which water has to rise there."""
    spill = np.full(seen.to.shape, -np.inf, np.float32)
    wet = np.where(seen.wet[ring.at] & ring.cut, seen.surface[ring.at], np.float32(-np.inf))
    spill[ring.at] = np.where(ring.shut, seen.surface[ring.at] + np.float32(WALL), wet)
    side = np.zeros(bed.shape, bool)
    for which, rim in zip(sides(bed.shape), ground.rims, strict=True):
        side[which] |= not rim
    at = np.nonzero(side & ~bed.fixed.reshape(bed.shape))
    near = ((n - odd + 1) // 2 for n, odd in zip(at, seen.odd, strict=True))
    near = tuple(np.clip(n, of.min(), of.max()) for n, of in zip(near, ring.at, strict=True))
    some = spill[near] > -np.inf
    return (at[0] * bed.shape[1] + at[1])[some], spill[near][some]
