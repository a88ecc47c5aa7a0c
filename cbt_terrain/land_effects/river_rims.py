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

# What the next finer level is told beside the layers: m, and m3 of sediment that come to a sample in a year.
LAKE, LOAD = "lake", "load"
# Metres that water would have to rise to leave where it comes in.
WALL = 1e4
# Surfaces of a lake differ by less, metres: by rounding, and where tiles of the coarser level meet.
LEVEL = 0.01
# Coarse samples along a cut: so near to where water comes in none leaves, but where the coarser level has a stream
# leave, a few samples to either side, that is not so many times less.
BESIDE, WANDER, LESS = 48, 4, 16.0
# Where that many times as much would leave as the coarser level has leave there, none does; looked for so often.
MORE, ROUNDS = 4.0, 5


def sides(shape: tuple[int, int]) -> list[tuple]:
    """South, north, west and east."""
    return [np.s_[0], np.s_[shape[0] - 1], np.s_[:, 0], np.s_[:, shape[1] - 1]]


def edges(bed: Bed, origin: np.ndarray, coarser: Change | None, years: float) -> Callable[[], None]:
    """What moves the samples along the four sides, where water leaves, after each step of `years` in all.

    At the coarsest level they fall with the sample inside them, so that a rim is no dam, but not below their lowest,
    which is the land's base level; they never rise. At finer ones they go the coarser level's way, lifted in every step
    with what lies beside them: moved after it they would be a moat around rising land, into which all of it drains.
    """
    (rows, columns), side = bed.shape, np.zeros(bed.shape, bool)
    for which in sides(bed.shape):
        side[which] = True
    side &= ~bed.fixed.reshape(bed.shape)
    j, i = np.nonzero(side)
    at = j * columns + i
    if not len(at):
        return lambda: None
    if coarser is not None:
        way = origin[at] + coarser.heights.reshape(-1)[at] - bed.heights[at]
        bed.lift[at] = way / np.float32(max(years, 1.0))
        return lambda: None
    inner = np.clip(j, 1, max(rows - 2, 0)) * columns + np.clip(i, 1, max(columns - 2, 0))
    lowest = origin[at].min()

    def fall() -> None:
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


@dataclass(frozen=True, eq=False)
class _Ring:
    """The outermost samples of the coarser level whose water's way is known, once around a tile; arrays [samples].

    `at`: rows and columns. `cut`: bool, not along the raster's own rim. `shut`: bool, none leaves here. `flow`:
    float64, what runs through, in fine samples; of a lake the most.
    """

    at: tuple[np.ndarray, np.ndarray]
    cut: np.ndarray
    shut: np.ndarray
    flow: np.ndarray


def take_over(bed: Bed, ground: Ground, coarser: Change) -> None:
    """Give the bed of a tile what comes over its cut, and what water has to rise to, to leave there."""
    if all(ground.rims):
        return
    seen = _seen(bed, ground, coarser)
    own, load = np.ones(bed.shape), np.zeros(bed.shape)

    def bring(some: np.ndarray, y: np.ndarray, x: np.ndarray, sign: float = 1.0) -> None:
        fine = 2 * y[some] + seen.odd[0], 2 * x[some] + seen.odd[1]
        np.add.at(own, fine, sign * seen.flow[some])
        np.add.at(load, fine, sign * seen.load[some])

    y, x = _receivers(seen)
    enters = ~seen.inside & (seen.to != 4) & seen.inside[y, x]
    enters &= ~seen.wet | (seen.flow[y, x] > seen.flow)
    bring(enters, y, x)
    # A river that winds along the cut does not leave: what comes back is in the tile already. Catchments grow along a
    # way: from where they do not, that of a lake's water is not seen.
    grows = seen.flow[y, x] > seen.flow
    y, x = (np.where(grows, n, at) for n, at in zip((y, x), np.indices(y.shape), strict=True))
    back = _ends(seen, y, x)
    again, into = tuple(n[y, x] for n in back), seen.inside[back]
    bring(seen.inside & ~seen.inside[y, x] & seen.inside[again], *again, sign=-1.0)
    ring = _ring(seen, ground, into)
    for lake in _lakes(seen, ring):
        most = lake[np.argmax(ring.flow[lake])]
        j, i = (n[most] for n in ring.at)
        ring.flow[lake] = ring.flow[most]
        ring.shut[lake] = into[j, i] | (ring.at[0][lake] != j) | (ring.at[1][lake] != i)
    # A stream that comes back may have less sediment, and of a coarser level's tiles where they meet less water.
    bed.own, bed.brought = np.maximum(own, 1.0).reshape(-1), np.maximum(load, 0.0).reshape(-1)
    _close(bed, ground, seen, ring)


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
    flow, load = ((array[every] * per).astype(np.float64) for array in (coarser.layers["flow"], coarser.kept[LOAD]))
    to = np.where(wet, *reversed([*ways])).astype(int)
    at, cut = _around(to.shape, ground.rims, 0)
    for j, i in zip(*(n[cut & ~fixed[at]] for n in at), strict=True):
        to[j, i] = _way_back(j, i, surface, flow)
    return _Seen(odd, surface, flow, load, wet, inside, to)


def _way_back(j: int, i: int, surface: np.ndarray, flow: np.ndarray) -> int:
    """Where the water of one of the outermost samples may run that is seen: to what is no higher, and has but a little
    more of it; 4 if there is none."""
    south, west = max(j - 1, 0), max(i - 1, 0)
    near = np.s_[south : j + 2, west : i + 2]
    more = np.where((flow[near] > flow[j, i]) & (surface[near] <= surface[j, i] + LEVEL), flow[near], np.inf)
    y, x = np.unravel_index(more.argmin(), more.shape)
    return 3 * (south + y - j + 1) + (west + x - i + 1) if np.isfinite(more[y, x]) else 4


def _around(shape: tuple[int, int], rims: tuple[bool, ...], inset: int):
    """Rows and columns of the samples along four sides, once around, those of cuts so far inside; and which are."""
    south, north, west, east = rims
    low, high = inset * (not south), shape[0] - 1 - inset * (not north)
    left, right = inset * (not west), shape[1] - 1 - inset * (not east)
    up, along = np.arange(low, high), np.arange(left, right)
    j = np.concatenate([np.full(len(along), low), up, np.full(len(along), high), up[::-1] + 1])
    i = np.concatenate([along, np.full(len(up), right), along[::-1] + 1, np.full(len(up), left)])
    return (j, i), np.repeat([not south, not east, not north, not west], [len(along), len(up)] * 2)


def _receivers(seen: _Seen) -> tuple[np.ndarray, np.ndarray]:
    """Row and column to which the water of each sample flows.

    Catchments grow along a way. On the floor of a lake the way to its pit is turned around to the outlet, and where
    that lies is not seen: where the catchment does not grow, it runs to that inside which is the largest.
    """
    y, x = np.indices(seen.to.shape)
    y, x = y + seen.to // 3 - 1, x + seen.to % 3 - 1
    within = np.where(seen.inside, seen.flow, -1.0)
    turned = seen.wet & ~seen.inside & (seen.to != 4) & (seen.flow[y, x] <= seen.flow)
    for j, i in zip(*np.nonzero(turned), strict=True):
        near = within[j - 1 : j + 2, i - 1 : i + 2]
        if near.max() > seen.flow[j, i]:
            y[j, i], x[j, i] = np.array(np.unravel_index(near.argmax(), near.shape)) + (j - 1, i - 1)
    return y, x


def _ring(seen: _Seen, ground: Ground, into: np.ndarray) -> _Ring:
    """Shut where the water of the sample flows into the tile, but for lakes."""
    at, cut = _around(seen.to.shape, ground.rims, 1)
    return _Ring(at, cut, (into & ~seen.wet)[at] & cut, seen.flow[at])


def _ends(seen: _Seen, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns at which the water of each sample runs into the tile, given where it runs next; where that is
    not within 16 samples, how far it comes."""
    shape, stays = y.shape, np.arange(y.size).reshape(y.shape)
    down = np.where(seen.inside, stays, y * shape[1] + x).reshape(-1)
    for _ in range(4):
        down = down[down]
    return np.unravel_index(down.reshape(shape), shape)


def _lakes(seen: _Seen, ring: _Ring) -> list[np.ndarray]:
    """Places in the ring of each lake that it runs through: of all those whose water stands alike."""
    at = np.flatnonzero(seen.wet[ring.at] & ring.cut)
    level = seen.surface[ring.at][at]
    order = np.argsort(level, kind="stable")
    return [] if not len(at) else np.split(at[order], np.flatnonzero(np.diff(level[order]) > LEVEL) + 1)


def _most(flow: np.ndarray, reach: int) -> np.ndarray:
    """The most of what runs through so many samples to either side, once around; of bools whether any."""
    return np.max([np.roll(flow, n) for n in range(-reach, reach + 1)], axis=0)


def _close(bed: Bed, ground: Ground, seen: _Seen, ring: _Ring) -> None:
    """Give the bed the samples along the cut that are no plain outlets, and metres to which water has to rise there.

    Shut is also what lies beside shut samples, since finer ground may dam what comes in there and lead it away; but not
    where about as much leaves: a river that winds along the cut would else be counted with every bend. Of these are
    shut where a river would leave that does not at the coarser level: a stream may leave to join one outside, and come
    back with it; a tile sees no farther than the outlet, and the river would take it.
    """
    wet = seen.wet[ring.at]
    open_ = ring.cut & ~ring.shut
    comes, leaves = _most(np.where(ring.shut, ring.flow, 0.0), BESIDE), _most(np.where(open_, ring.flow, 0.0), WANDER)
    open_ &= ~wet
    shut = ring.shut | (open_ & (comes > LESS * leaves))
    at, place = _along(bed, ground, seen, ring)
    for _ in range(ROUNDS):
        some = (shut | wet)[place]
        bed.rim, bed.spill = at[some], (seen.surface[ring.at] + np.float32(WALL) * shut)[place[some]]
        out = np.zeros(len(shut))
        np.maximum.at(out, place, bed.drain().catchments[at])
        more = open_ & ~shut & (comes > leaves) & (out > MORE * leaves)
        if not more.any():
            break
        shut |= open_ & _most(more, WANDER)


def _along(bed: Bed, ground: Ground, seen: _Seen, ring: _Ring) -> tuple[np.ndarray, np.ndarray]:
    """int64: the samples along the cut where water may leave, and of each the place in the ring that it is next to."""
    at, cut = _around(bed.shape, ground.rims, 0)
    near = ((n - odd + 1) // 2 for n, odd in zip(at, seen.odd, strict=True))
    near = tuple(np.clip(n, of.min(), of.max()) for n, of in zip(near, ring.at, strict=True))
    places = np.zeros(seen.to.shape, np.int64)
    places[ring.at] = np.arange(len(ring.flow))
    at = at[0] * bed.shape[1] + at[1]
    cut &= ~bed.fixed[at]
    return at[cut], places[near][cut]
