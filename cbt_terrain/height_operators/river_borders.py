# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundary conditions of rivers at the border of a level and at the cut of a tile.

Water leaves at the border of a level. At the cut of a tile the coarser level's water surface and drainage area tell
where water and sediment enter; none leaves there. Without them a lake would leave over the lowest sample of the cut.

A `Bed` is the state of this level or tile, arrays of n samples in C order. `fixed`: samples that do not change and let
water leave; `border`, `outlet_level`: samples where water leaves only above a height; `cell_weight`: upstream samples
that a sample stands for; `inflow`: sediment that enters.

A `_Coarse` is the coarser level in the tile: `odd`, row and column, 0 or 1, of its first sample among this level's;
`flow`, drainage area in samples of this level; `load`, sediment; `wet`, in a lake; `inside`, away from the cut; `to`,
the D8 direction of the receiver, 4 for the sample itself. A `_Ring` are its samples along the sides of the tile, in
order. `rims` of the ground tell whether its south, north, west and east side is the raster's border and no cut.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .height_operator import Change, OperatorGround

if TYPE_CHECKING:
    from .fluvial import Bed

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
    """Return row and column of the neighbour of (y, x) in a D8 direction `way`: 3 * (north + 1) + east + 1.

    north, east: -1, 0 or 1, so that 4 is the sample itself.
    """
    return y + way // 3 - 1, x + way % 3 - 1


def sides(shape: tuple[int, ...]) -> list[tuple]:
    """Return indices of the south, north, west and east side of an array."""
    every = slice(None)
    return [(0, every), (shape[0] - 1, every), (every, 0), (every, shape[1] - 1)]


def border_motion(bed: "Bed", origin: np.ndarray, coarser: Change | None, years: float) -> Callable[[], None]:
    """Return a function that moves the border samples after each step.

    origin: float32 [n] m, heights before all steps. coarser: the coarser level's change, None at the coarsest level.
    years: sum of all steps.

    At the coarsest level they sink with the sample inside them, so that a border is no dam, but not below their lowest,
    which is the base level; they never rise. At finer levels they follow the coarser change as an uplift in every
    step. If they moved at the end, they would be a moat around rising land that drains all of it.
    """
    (rows, columns), is_border = bed.shape, np.zeros(bed.shape, bool)
    for side in sides(bed.shape):
        is_border[side] = True
    is_border &= ~bed.fixed.reshape(bed.shape)
    j, i = np.nonzero(is_border)
    border = j * columns + i
    if not len(border):
        return lambda: None
    if coarser is not None:
        motion = origin[border] + coarser.heights.reshape(-1)[border] - bed.heights[border]
        bed.uplift[border] = motion / np.float32(max(years, 1.0))
        return lambda: None  # the steps move it
    # The sample inside of each border sample.
    inner = np.clip(j, 1, max(rows - 2, 0)) * columns + np.clip(i, 1, max(columns - 2, 0))
    lowest = origin[border].min()

    def lower_border() -> None:
        """Lower the border by as much as the samples inside of it have sunk since the start, down to `lowest`."""
        change = np.minimum(bed.heights[inner] - origin[inner], np.float32(0.0))
        bed.heights[border] = np.maximum(origin[border] + change, lowest)

    return lower_border


@dataclass(frozen=True, eq=False)
class _Coarse:
    """The coarser level at its samples in a tile, every second one; arrays [rows, columns].

    Attributes:
        odd: row and column of the first in the tile, 0 or 1 each.
        surface: float32 m, of ground and lakes.
        flow: float64, drainage area in fine samples. load: float64, sediment, metres times fine samples a year.
        wet: bool, lakes.
        inside: bool, not the outermost two samples along a cut, since the receivers of the outermost are unknown.
        to: directions of receivers (`neighbour`), by the surface; in lakes by the floor.
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
        at: rows and columns in the arrays of _Coarse.
        cut: bool, along the cut of a tile and not the raster's border.
        shut: bool, no water leaves.
        flow: float64, drainage area in fine samples, for a lake its maximum.
    """

    at: tuple[np.ndarray, np.ndarray]
    cut: np.ndarray
    shut: np.ndarray
    flow: np.ndarray


def set_boundary(bed: "Bed", ground: OperatorGround, coarser: Change) -> None:
    """Set drainage area and sediment that flow in, closed border samples and outlet levels of a tile's bed.

    They follow from the coarser level. coarser: its change, interpolated to `ground`.
    """
    if all(ground.rims):  # no side is a cut
        return
    coarse = _coarse_samples(bed, ground, coarser)
    # Water and sediment that enter, at this level's samples; the coarse samples that are inside or whose water enters.
    cell_weight, load, comes_in = _inflow(coarse, bed.shape)
    # The outermost coarse samples with known receivers, shut where water that is in no lake would enter the tile.
    at, cut = _around(coarse.to.shape, ground.rims, inset=1)
    ring = _Ring(at, cut, shut=(comes_in & ~coarse.wet)[at] & cut, flow=coarse.flow[at])
    # Water of a lake on the ring leaves only at its sample with the largest area, and not there if it comes in there.
    for lake in _lakes(coarse, ring):  # indices in the ring of one lake's samples
        largest = lake[np.argmax(ring.flow[lake])]
        j, i = (n[largest] for n in ring.at)
        ring.flow[lake] = ring.flow[largest]
        ring.shut[lake] = comes_in[j, i] | (ring.at[0][lake] != j) | (ring.at[1][lake] != i)
    # Not below 1 and 0: a stream that comes back may carry less sediment than it took along, and less water where tiles
    # of the coarser level meet.
    bed.cell_weight, bed.inflow = np.maximum(cell_weight, 1.0).reshape(-1), np.maximum(load, 0.0).reshape(-1)
    _close(bed, ground, coarse, ring)


def _inflow(coarse: _Coarse, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the water and sediment that enter at each sample of a tile, and from which coarse samples water enters.

    The first array is the drainage area that each sample stands for, in samples: 1, and that of water that enters
    there. The second is sediment, metres times samples a year. Both are float64 of the tile's `shape`. The last, bool
    for each coarse sample, is True if it is inside or its water enters further downstream.
    """
    cell_weight, load = np.ones(shape), np.zeros(shape)

    def add(origins: np.ndarray, y: np.ndarray, x: np.ndarray, sign: float = 1.0) -> None:
        """Add water and sediment that come from some coarser samples to this level's samples.

        origins: bool, the coarser samples that they leave. y, x: coarse row and column where those of each sample
        arrive. sign: -1 to take them away.
        """
        fine = 2 * y[origins] + coarse.odd[0], 2 * x[origins] + coarse.odd[1]
        np.add.at(cell_weight, fine, sign * coarse.flow[origins])
        np.add.at(load, fine, sign * coarse.load[origins])

    y, x = _receivers(coarse)
    # Water enters from a sample outside to its receiver inside. In a lake, whose directions follow the floor, only a
    # larger drainage area shows that water really goes there.
    enters = ~coarse.inside & (coarse.to != 4) & coarse.inside[y, x]
    enters &= ~coarse.wet | (coarse.flow[y, x] > coarse.flow)
    add(enters, y, x)
    # Drainage area grows downstream. Where it does not, the way of a lake's water is unknown: the path ends there,
    # as the sample becomes its own receiver.
    grows = coarse.flow[y, x] > coarse.flow
    y, x = (np.where(grows, n, itself) for n, itself in zip((y, x), np.indices(y.shape), strict=True))
    entry = _entries(coarse, y, x)
    comes_in = coarse.inside[entry]
    # A river that winds along the cut may leave and come back: its water, which the tile has already, is taken away.
    reentry = entry[0][y, x], entry[1][y, x]  # where the water of each sample's receiver enters
    add(coarse.inside & ~coarse.inside[y, x] & coarse.inside[reentry], *reentry, sign=-1.0)
    return cell_weight, load, comes_in


def _coarse_samples(bed: "Bed", ground: OperatorGround, coarser: Change) -> _Coarse:
    """Return the coarser level's water, sediment and receivers at its samples in a tile, as `_Coarse` defines them.

    `coarser`: its change, interpolated to the tile; every second sample of it is one of the coarser level. Receivers
    along a cut follow from drainage area, since the ground beyond is unknown there.
    """
    from ..attributes.routing import route

    odd = ground.first[0] % 2, ground.first[1] % 2
    coarse = tuple(slice(n, None, 2) for n in odd)
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[coarse])
    lake, fixed = coarser.state[LAKE][coarse], bed.fixed.reshape(bed.shape)[coarse]
    surface, wet = floor + lake, lake > 0.0
    steps = 2 * ground.step_x, 2 * ground.step_y
    by_surface, by_floor = (  # directions of receivers
        route(heights, *steps, fixed, ground.threads).to.reshape(floor.shape) for heights in (surface, floor)
    )
    inside = np.zeros(floor.shape, bool)  # two samples from cuts, as `_Coarse` explains
    south, north, west, east = (0 if border else 2 for border in ground.rims)
    inside[south : len(floor) - north, west : floor.shape[1] - east] = True
    samples_per_m2 = 1.0 / (ground.step_x * ground.step_y)
    flow, load = (  # in samples of this level, and metres times these a year
        (array[coarse] * samples_per_m2).astype(np.float64) for array in (coarser.layers["flow"], coarser.state[LOAD])
    )
    to = np.where(wet, by_floor, by_surface).astype(int)  # the surface of a lake is level, so its floor decides
    outermost, cut = _around(to.shape, ground.rims, inset=0)
    for j, i in zip(*(n[cut & ~fixed[outermost]] for n in outermost), strict=True):
        to[j, i] = _receiver_at_edge(j, i, surface, flow)
    return _Coarse(odd, surface=surface, flow=flow, load=load, wet=wet, inside=inside, to=to)


def _receiver_at_edge(j: int, i: int, surface: np.ndarray, flow: np.ndarray) -> int:
    """Return the D8 direction of the receiver of an outermost sample, coarse row j and column i; 4 if there is none.

    It is the neighbour with the least drainage area of those that have more than the sample and are no higher: area
    grows downstream, so the next larger one is the next along a river. surface: metres. flow: drainage areas.
    """
    south, west = max(j - 1, 0), max(i - 1, 0)
    neighbours = np.s_[south : j + 2, west : i + 2]
    may_receive = (flow[neighbours] > flow[j, i]) & (surface[neighbours] <= surface[j, i] + LEVEL)
    larger_flow = np.where(may_receive, flow[neighbours], np.inf)
    y, x = np.unravel_index(larger_flow.argmin(), larger_flow.shape)
    return int(3 * (south + y - j + 1) + (west + x - i + 1)) if np.isfinite(larger_flow[y, x]) else 4


def _around(shape: tuple[int, ...], rims: tuple[bool, ...], inset: int) -> tuple[Positions, np.ndarray]:
    """Return rows and columns of the samples along four sides of a tile, and which of them are on cuts (bool).

    They go around counter-clockwise from the south-west, and each corner belongs to one side. rims: whether the south,
    north, west and east side is the raster's border; the others are cuts, whose samples are taken `inset` samples
    inside.
    """
    south, north, west, east = rims
    low, high = inset * (not south), shape[0] - 1 - inset * (not north)
    left, right = inset * (not west), shape[1] - 1 - inset * (not east)
    up, along = np.arange(low, high), np.arange(left, right)
    j = np.concatenate([np.full(len(along), low), up, np.full(len(along), high), up[::-1] + 1])
    i = np.concatenate([along, np.full(len(up), right), along[::-1] + 1, np.full(len(up), left)])
    return (j, i), np.repeat([not south, not east, not north, not west], [len(along), len(up)] * 2)


def _receivers(coarse: _Coarse) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of each coarse sample's receiver: its neighbour in direction `to`, except in some lakes.

    In a lake `to` leads along the floor to the outlet, which may be outside of the tile. If a lake's sample outside has
    a receiver with no larger drainage area, water cannot go there; then the neighbour inside with the largest drainage
    area becomes its receiver.
    """
    y, x = np.indices(coarse.to.shape)
    y, x = neighbour(y, x, coarse.to)
    inner_flow = np.where(coarse.inside, coarse.flow, -1.0)
    turned = coarse.wet & ~coarse.inside & (coarse.to != 4) & (coarse.flow[y, x] <= coarse.flow)
    for j, i in zip(*np.nonzero(turned), strict=True):  # none is outermost: their receivers have more flow
        near = inner_flow[j - 1 : j + 2, i - 1 : i + 2]
        if near.max() > coarse.flow[j, i]:
            y[j, i], x[j, i] = np.array(np.unravel_index(near.argmax(), near.shape)) + (j - 1, i - 1)
    return y, x


def _entries(coarse: _Coarse, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return row and column of the place where the water of each sample enters the tile, followed for up to 16 samples.

    For a sample inside it is the sample itself. y, x: row and column of each sample's receiver. coarse: the coarser
    level.
    """
    shape, itself = y.shape, np.arange(y.size).reshape(y.shape)  # samples are numbered in C order
    down = np.where(coarse.inside, itself, y * shape[1] + x).reshape(-1)
    for _ in range(4):  # each time the followed path becomes twice as long
        down = down[down]
    row, column = np.unravel_index(down.reshape(shape), shape)
    return row, column


def _lakes(coarse: _Coarse, ring: _Ring) -> list[np.ndarray]:
    """Return the lakes on the ring of border samples, each as indices in the ring.

    Samples with one water level are one lake. coarse: the coarser level.
    """
    in_lake = np.flatnonzero(coarse.wet[ring.at] & ring.cut)
    level = coarse.surface[ring.at][in_lake]
    order = np.argsort(level, kind="stable")
    return [] if not len(in_lake) else np.split(in_lake[order], np.flatnonzero(np.diff(level[order]) > LEVEL) + 1)


def _max_along(flow: np.ndarray, reach: int) -> np.ndarray:
    """Return the maximum of the flow within `reach` samples to both sides along the ring, which is closed."""
    return np.max([np.roll(flow, n) for n in range(-reach, reach + 1)], axis=0)


def _close(bed: "Bed", ground: OperatorGround, coarse: _Coarse, ring: _Ring) -> None:
    """Close samples along a tile's cut to water, and set the levels above which it leaves at samples of lakes.

    The results are `bed.border` and `bed.outlet_level`. The level is WALL metres above the coarser surface at a closed
    sample, and that surface at an open one of a lake; water leaves freely at other samples.

    Closed are, in this order: (1) the samples that `ring.shut` marks, where water enters the tile, and all samples of a
    lake but its outlet. (2) Samples within BESIDE of an inflow, because finer ground may dam the inflow and lead it
    away; but not within WANDER of a coarser outflow that is not far smaller (LESS), as along a river that winds along
    the cut. (3) Samples near an inflow where routing over the finer ground, up to ROUNDS times, finds more than MORE
    times the coarser outflow: a stream that leaves to join one outside and comes back with it would be lost.
    """
    wet = coarse.wet[ring.at]
    may_close = ring.cut & ~ring.shut
    # For each sample of the ring: the largest inflow and the largest coarser outflow nearby, as drainage areas.
    inflow = _max_along(np.where(ring.shut, ring.flow, 0.0), BESIDE)
    outflow = _max_along(np.where(may_close, ring.flow, 0.0), WANDER)
    may_close &= ~wet  # those of lakes are decided in `set_boundary`
    # No water leaves near an inflow, unless a coarser outflow within WANDER has at least 1 / LESS of its area.
    shut = ring.shut | (may_close & (inflow > LESS * outflow))
    # This level's samples along the cut, and the index in the ring of the coarse sample nearest to each.
    samples, ring_index = _samples_along_cut(bed, ground, coarse, ring)
    # Close more, until the bed drains nowhere along the cut much more than the coarser level does.
    for _ in range(ROUNDS):
        is_border = (shut | wet)[ring_index]
        bed.border = samples[is_border]
        bed.outlet_level = (coarse.surface[ring.at] + np.float32(WALL) * shut)[ring_index[is_border]]
        leaving = np.zeros(len(shut))  # the largest drainage area that leaves near each sample of the ring
        np.maximum.at(leaving, ring_index, bed.drain().catchments[samples])  # uses the levels
        too_much = may_close & ~shut & (inflow > outflow) & (leaving > MORE * outflow)
        if not too_much.any():
            break
        shut |= may_close & _max_along(too_much, WANDER)


def _samples_along_cut(
    bed: "Bed", ground: OperatorGround, coarse: _Coarse, ring: _Ring
) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples along the cut where water may leave, and the index of the ring's sample nearest to each.

    Samples are numbers in the tile, in C order; both int64.
    """
    outermost, cut = _around(bed.shape, ground.rims, inset=0)
    # Coarse sample k is sample 2 k + odd, so the nearest one to n is (n - odd + 1) // 2; then the nearest of the ring.
    halves = ((n - odd + 1) // 2 for n, odd in zip(outermost, coarse.odd, strict=True))
    nearest = tuple(np.clip(n, along.min(), along.max()) for n, along in zip(halves, ring.at, strict=True))
    ring_indices = np.zeros(coarse.to.shape, np.int64)
    ring_indices[ring.at] = np.arange(len(ring.flow))
    samples = outermost[0] * bed.shape[1] + outermost[1]
    cut &= ~bed.fixed[samples]
    return samples[cut], ring_indices[nearest][cut]
