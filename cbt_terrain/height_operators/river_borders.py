# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundary conditions of rivers at the border of a level and at the cut of a tile.

Water leaves at the border of a level. At the cut of a tile the coarser level's water surface and drainage area tell
where water and sediment enter; none leaves there. Without them a lake would leave over the lowest sample of the cut.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..attributes.routing import route
from .fluvial import Bed
from .height_operator import Change, OperatorGround

# Arrays for the next finer level (Change.state): depth of lakes in m, and sediment that comes to a sample, m3 a year.
LAKE, LOAD = "lake", "load"
# Metres that water would have to rise to leave where it enters.
WALL = 1e4
# Tolerance in metres of the surface of one lake, for rounding and where tiles of the coarser level meet.
LEVEL = 0.01
# No water leaves within BESIDE coarse samples along the cut of an inflow, except within WANDER of a coarser outflow of
# at least 1 / LESS of the inflow.
BESIDE, WANDER, LESS = 48, 4, 16.0
# An outlet with MORE times the coarser outflow is closed; ROUNDS: iterations of this search.
MORE, ROUNDS = 4.0, 5


# Rows and columns of samples, int [n] each.
Positions = tuple[np.ndarray, np.ndarray]


def neighbour(y: np.ndarray, x: np.ndarray, way: np.ndarray | int) -> Positions:
    """Return row and column of the neighbour in a D8 direction: 3 * (north + 1) + east + 1, 4 is the sample itself."""
    return y + way // 3 - 1, x + way % 3 - 1


def sides(shape: tuple[int, ...]) -> list[tuple]:
    """Return indices of the south, north, west and east side of an array."""
    every = slice(None)
    return [(0, every), (shape[0] - 1, every), (every, 0), (every, shape[1] - 1)]


def border_motion(bed: Bed, origin: np.ndarray, coarser: Change | None, years: float) -> Callable[[], None]:
    """Return a function that moves the border samples after each step; `years`: sum of all steps.

    At the coarsest level they sink with the sample inside them, so that a border is no dam, but not below their lowest,
    which is the base level; they never rise. At finer levels they follow the coarser change as an uplift in every
    step. If they moved at the end, they would be a moat around rising land that drains all of it.
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
        bed.uplift[at] = way / np.float32(max(years, 1.0))
        return lambda: None
    inner = np.clip(j, 1, max(rows - 2, 0)) * columns + np.clip(i, 1, max(columns - 2, 0))
    lowest = origin[at].min()

    def lower_border() -> None:
        """Lower the border by as much as the samples inside of it have sunk since the start, down to `lowest`."""
        change = np.minimum(bed.heights[inner] - origin[inner], np.float32(0.0))
        bed.heights[at] = np.maximum(origin[at] + change, lowest)

    return lower_border


@dataclass(frozen=True, eq=False)
class _Coarse:
    """The coarser level at its samples in a tile, every second one; arrays [rows, columns].

    Attributes:
        odd: row and column of the first.
        surface: float32 m, of ground and lakes.
        flow: float64, drainage area in fine samples. load: float64, sediment, metres times fine samples a year.
        wet: bool, lakes.
        inside: bool, not the outermost two samples along a cut, since the receivers of the outermost are unknown.
        to: receivers by the surface, on the floors of lakes by the floor.
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
    """The outermost coarse samples with known receivers, once around a tile; arrays [samples].

    Attributes:
        at: rows and columns.
        cut: bool, along the cut of a tile and not the raster's border.
        shut: bool, no water leaves.
        flow: float64, drainage area in fine samples, for a lake its maximum.
    """

    at: tuple[np.ndarray, np.ndarray]
    cut: np.ndarray
    shut: np.ndarray
    flow: np.ndarray


def set_boundary(bed: Bed, ground: OperatorGround, coarser: Change) -> None:
    """Set inflow, closed border samples and outlet levels of a tile's bed from the coarser level."""
    if all(ground.rims):  # no side is a cut
        return
    seen = _coarse_samples(bed, ground, coarser)
    cell_weight, load = np.ones(bed.shape), np.zeros(bed.shape)

    def add_inflow(some: np.ndarray, y: np.ndarray, x: np.ndarray, sign: float = 1.0) -> None:
        """Add water and sediment that come from some coarser samples to this level's samples.

        some: indices of the ring. y, x: the coarser samples. sign: -1 to take them away.
        """
        fine = 2 * y[some] + seen.odd[0], 2 * x[some] + seen.odd[1]
        np.add.at(cell_weight, fine, sign * seen.flow[some])
        np.add.at(load, fine, sign * seen.load[some])

    y, x = _receivers(seen)
    enters = ~seen.inside & (seen.to != 4) & seen.inside[y, x]
    enters &= ~seen.wet | (seen.flow[y, x] > seen.flow)
    add_inflow(enters, y, x)
    # The water of a river that winds along the cut and comes back is in the tile already. Drainage area grows
    # downstream; where it does not, the path of a lake's water is unknown.
    grows = seen.flow[y, x] > seen.flow
    y, x = (np.where(grows, n, at) for n, at in zip((y, x), np.indices(y.shape), strict=True))
    back = _ends(seen, y, x)
    again, into = (back[0][y, x], back[1][y, x]), seen.inside[back]
    add_inflow(seen.inside & ~seen.inside[y, x] & seen.inside[again], again[0], again[1], sign=-1.0)
    ring = _ring(seen, ground, into)
    for lake in _lakes(seen, ring):
        largest = lake[np.argmax(ring.flow[lake])]
        j, i = (n[largest] for n in ring.at)
        ring.flow[lake] = ring.flow[largest]
        ring.shut[lake] = into[j, i] | (ring.at[0][lake] != j) | (ring.at[1][lake] != i)
    # A stream that comes back may carry less sediment, and less water where tiles of the coarser level meet.
    bed.cell_weight, bed.inflow = np.maximum(cell_weight, 1.0).reshape(-1), np.maximum(load, 0.0).reshape(-1)
    _close(bed, ground, seen, ring)


def _coarse_samples(bed: Bed, ground: OperatorGround, coarser: Change) -> _Coarse:
    """Return the coarser level's surface, flow, sediment and receivers at its samples in a tile.

    `coarser`: its change, interpolated to the tile; every second sample of it is one of the coarser level. Receivers
    along a cut follow from drainage area, since the ground beyond is unknown there.
    """
    odd = ground.first[0] % 2, ground.first[1] % 2
    every, per = tuple(slice(n, None, 2) for n in odd), 1.0 / (ground.step_x * ground.step_y)
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[every])
    lake, fixed = coarser.state[LAKE][every], bed.fixed.reshape(bed.shape)[every]
    surface, wet = floor + lake, lake > 0.0
    steps = 2 * ground.step_x, 2 * ground.step_y
    ways = (route(heights, *steps, fixed, ground.threads).to.reshape(floor.shape) for heights in (surface, floor))
    inside = np.zeros(floor.shape, bool)
    south, north, west, east = (0 if border else 2 for border in ground.rims)
    inside[south : len(floor) - north, west : floor.shape[1] - east] = True
    flow, load = ((array[every] * per).astype(np.float64) for array in (coarser.layers["flow"], coarser.state[LOAD]))
    by_surface, by_floor = ways
    to = np.where(wet, by_floor, by_surface).astype(int)
    at, cut = _around(to.shape, ground.rims, inset=0)
    for j, i in zip(*(n[cut & ~fixed[at]] for n in at), strict=True):
        to[j, i] = _way_back(j, i, surface, flow)
    return _Coarse(odd, surface, flow, load, wet, inside, to)


def _way_back(j: int, i: int, surface: np.ndarray, flow: np.ndarray) -> int:
    """Return the direction of an outermost sample's receiver, 4 if there is none.

    The receiver is the neighbour that is no higher and has the least larger drainage area.
    """
    south, west = max(j - 1, 0), max(i - 1, 0)
    near = np.s_[south : j + 2, west : i + 2]
    more = np.where((flow[near] > flow[j, i]) & (surface[near] <= surface[j, i] + LEVEL), flow[near], np.inf)
    y, x = np.unravel_index(more.argmin(), more.shape)
    return int(3 * (south + y - j + 1) + (west + x - i + 1)) if np.isfinite(more[y, x]) else 4


def _around(shape: tuple[int, ...], rims: tuple[bool, ...], inset: int) -> tuple[Positions, np.ndarray]:
    """Return rows and columns of the samples along four sides of a tile, and which of them are on cuts.

    rims: whether the south, north, west and east side is the raster's border; the others are cuts, whose samples are
    taken `inset` samples inside.
    """
    south, north, west, east = rims
    low, high = inset * (not south), shape[0] - 1 - inset * (not north)
    left, right = inset * (not west), shape[1] - 1 - inset * (not east)
    up, along = np.arange(low, high), np.arange(left, right)
    j = np.concatenate([np.full(len(along), low), up, np.full(len(along), high), up[::-1] + 1])
    i = np.concatenate([along, np.full(len(up), right), along[::-1] + 1, np.full(len(up), left)])
    return (j, i), np.repeat([not south, not east, not north, not west], [len(along), len(up)] * 2)


def _receivers(seen: _Coarse) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of each sample's receiver.

    On the floor of a lake the path to its pit is reversed towards the outlet, which may be outside. Where the drainage
    area does not grow downstream, the receiver is the neighbour inside with the largest one.
    """
    y, x = np.indices(seen.to.shape)
    y, x = neighbour(y, x, seen.to)
    within = np.where(seen.inside, seen.flow, -1.0)
    turned = seen.wet & ~seen.inside & (seen.to != 4) & (seen.flow[y, x] <= seen.flow)
    for j, i in zip(*np.nonzero(turned), strict=True):
        near = within[j - 1 : j + 2, i - 1 : i + 2]
        if near.max() > seen.flow[j, i]:
            y[j, i], x[j, i] = np.array(np.unravel_index(near.argmax(), near.shape)) + (j - 1, i - 1)
    return y, x


def _ring(seen: _Coarse, ground: OperatorGround, into: np.ndarray) -> _Ring:
    """Return the ring of border samples, shut where water would flow into the tile from samples without a lake.

    into: whether the coarser level's water flows into the tile, bool.
    """
    at, cut = _around(seen.to.shape, ground.rims, inset=1)
    return _Ring(at, cut, (into & ~seen.wet)[at] & cut, seen.flow[at])


def _ends(seen: _Coarse, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns where the water of each sample enters the tile, followed for up to 16 samples.

    seen: where the samples lie inside of the tile. y, x: row and column of each sample's receiver, to which its water
    flows.
    """
    shape, itself = y.shape, np.arange(y.size).reshape(y.shape)
    down = np.where(seen.inside, itself, y * shape[1] + x).reshape(-1)
    for _ in range(4):
        down = down[down]
    row, column = np.unravel_index(down.reshape(shape), shape)
    return row, column


def _lakes(seen: _Coarse, ring: _Ring) -> list[np.ndarray]:
    """Return the indices in the ring of each lake on it; samples of one level are one lake."""
    at = np.flatnonzero(seen.wet[ring.at] & ring.cut)
    level = seen.surface[ring.at][at]
    order = np.argsort(level, kind="stable")
    return [] if not len(at) else np.split(at[order], np.flatnonzero(np.diff(level[order]) > LEVEL) + 1)


def _max_along(flow: np.ndarray, reach: int) -> np.ndarray:
    """Return the maximum of the flow within `reach` samples to both sides along the ring."""
    return np.max([np.roll(flow, n) for n in range(-reach, reach + 1)], axis=0)


def _close(bed: Bed, ground: OperatorGround, seen: _Coarse, ring: _Ring) -> None:
    """Set the bed's closed border samples and the levels where water leaves there.

    Samples near an inflow are closed too, since finer ground may dam it and lead it away; but not where about as much
    leaves, as a river that winds along the cut would count with every bend. Of these, samples are closed where a river
    would leave that does not at the coarser level: a stream may leave to join one outside and come back with it, and a
    tile, which ends at the outlet, would lose the river.
    """
    wet = seen.wet[ring.at]
    is_open = ring.cut & ~ring.shut
    inflow = _max_along(np.where(ring.shut, ring.flow, 0.0), BESIDE)
    outflow = _max_along(np.where(is_open, ring.flow, 0.0), WANDER)
    is_open &= ~wet
    shut = ring.shut | (is_open & (inflow > LESS * outflow))
    at, index = _along(bed, ground, seen, ring)
    for _ in range(ROUNDS):
        some = (shut | wet)[index]
        bed.border, bed.outlet_level = at[some], (seen.surface[ring.at] + np.float32(WALL) * shut)[index[some]]
        out = np.zeros(len(shut))
        np.maximum.at(out, index, bed.drain().catchments[at])
        more = is_open & ~shut & (inflow > outflow) & (out > MORE * outflow)
        if not more.any():
            break
        shut |= is_open & _max_along(more, WANDER)


def _along(bed: Bed, ground: OperatorGround, seen: _Coarse, ring: _Ring) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples along the cut where water may leave and the nearest index in the ring of each, int64."""
    at, cut = _around(bed.shape, ground.rims, inset=0)
    halves = ((n - odd + 1) // 2 for n, odd in zip(at, seen.odd, strict=True))
    near = tuple(np.clip(n, of.min(), of.max()) for n, of in zip(halves, ring.at, strict=True))
    indices = np.zeros(seen.to.shape, np.int64)
    indices[ring.at] = np.arange(len(ring.flow))
    samples = at[0] * bed.shape[1] + at[1]
    cut &= ~bed.fixed[samples]
    return samples[cut], indices[near][cut]
