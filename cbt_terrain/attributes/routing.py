# SPDX-License-Identifier: GPL-3.0-or-later
"""Drainage of a whole raster: receivers, order, filled surface and areas; kernels/effects has the methods.

The receiver of a sample is the neighbour that its water flows to; the sample is a donor of that one. Water leaves at
the samples of `base`. A pit is the lowest sample of a depression, or the first one of several; all that drains to it is
its basin. Arrays have an entry for each of n samples, in C order.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from ...kernels.effects import catchment, routing
from ...kernels.effects import rows as kernels
from ..run import launch
from ..run.buffers import flat

BLOCK = 1 << 16
# Returns an array of a shape and dtype, of any content: np.empty, or scratch_array of field/derived_arrays.py.
Allocate = Callable[[tuple[int, ...], type], np.ndarray]
# With noise in the choice of receivers, slopes along diagonals are multiplied by this (compare Rho8, Fairfield and
# Leymarie 1991). Diagonal steps are longer, so that the mean path down a plane would turn towards a diagonal by up to
# 3.5 degrees, and rills by up to 10; with this factor a path turns by at most 1.3 on square cells. On other cells a
# slope along an axis is also multiplied by the square root of the other step over its own. The mean path then turns by
# 3 degrees rms at 2 : 1 and 5 at 3 : 1 (13 and 20 without), and valleys lean towards the longer steps by 9 and 10 (12
# and 16). A power of 3 / 4 gives 7 and 8, and paths 6 and 10, but more straight valleys along the shorter steps.
DIAGONAL = 0.86


@dataclass(eq=False)
class Drainage:
    """The drainage of a raster; arrays of n samples in C order.

    `base`: uint8, 1 where water leaves. `to`: uint8, direction of the receiver, 3 * (dy + 1) + dx + 1, 4 for a root,
    which is always of `base`. `order`: int32, indices with donors before receivers; `areas` sorts them by height.
    `heights`: float32 metres. `catchments`: float64, drainage area in samples by single receivers; empty if `route` got
    no weights. `allocate`: makes the arrays of results and scratch.
    """

    grid: kernels.Grid
    heights: np.ndarray
    base: np.ndarray
    to: np.ndarray
    order: np.ndarray
    catchments: np.ndarray
    allocate: Allocate = np.empty

    def packed(self, filled: np.ndarray) -> kernels.DrainageArrays:
        """Return the arrays as kernels read them; the memory is shared. filled: surface of lakes, float32 [n] m."""
        d = kernels.DrainageArrays()
        d.grid, d.to, d.order = self.grid, flat(self.to, wp.uint8), flat(self.order, wp.int32)
        d.h, d.filled = flat(self.heights, wp.float32), flat(filled, wp.float32)
        return d

    def filled(self) -> np.ndarray:
        """Return the lowest surface at or above the heights from which every sample drains, float32 [n] metres."""
        out = self.allocate(self.heights.shape, np.float32)
        launch.once(catchment.fill_lakes, [self.packed(out)], step="routing")
        return out

    def areas(self, filled: np.ndarray, stream: float = math.inf) -> np.ndarray:
        """Return drainage areas in samples, float64 [n]: each sample's is divided among all lower neighbours.

        filled: the lowest surface from which every sample drains, float32 [n] m: that of lakes, elsewhere the ground.
        stream: samples; areas from this one on are not divided and go to the receiver, as water in a channel.
        Sorts `order` by it, the highest first; donors remain before receivers.
        """
        d = self.packed(filled)
        launch.once(catchment.sort_order, [d, *_scratch_of_sort(len(self.to), self.allocate)], step="routing")
        area = self.allocate(self.to.shape, np.float64)
        area.fill(1.0)  # of each sample alone, to which the kernel adds those upstream
        d.area = flat(area, wp.float64)
        launch.once(catchment.gather_area, [d, stream], step="routing")
        return area

    def level_lakes(self, filled: np.ndarray, area: np.ndarray) -> None:
        """Set the area of all samples of a lake to that of its outlet, in place.

        filled: the lowest surface from which every sample drains, float32 [n] m. area: drainage areas, float64 [n]
        samples.
        """
        d = self.packed(filled)
        d.area = flat(area, wp.float64)
        launch.once(catchment.level_lakes, [d], step="routing")


def route(
    heights: np.ndarray,
    step_x: float,
    step_y: float,
    holes: np.ndarray | None = None,
    threads: int = 1,
    noise: "routing.ReceiverNoise | None" = None,
    cell_weight: np.ndarray | None = None,
    allocate: Allocate = np.empty,
) -> Drainage:
    """Route water over heights, float32 [rows, columns] metres, samples `step_x` and `step_y` metres apart.

    Water leaves at the border and in `holes` (bool, same shape). Depressions drain over their lowest passes, flats
    along the shortest paths. noise: random factors of slopes where receivers are chosen, which break straight lines;
    None for none. cell_weight: float64 of the same shape, weights whose sums over all samples upstream become the
    `catchments` of the result; None to compute none. The result does not depend on `threads`. heights: without NaN, at
    least two rows and columns; the result shares their memory if they are contiguous. allocate: makes the arrays of the
    result, except `catchments`, and of scratch.
    """
    rows, columns = heights.shape
    base = allocate(heights.shape, np.uint8)
    base[:] = 0 if holes is None else holes
    base[[0, -1]] = 1
    base[:, [0, -1]] = 1
    base, h = base.reshape(-1), heights.reshape(-1)
    grid = grid_of(rows, columns, step_x, step_y)
    to = _find_receivers(grid, h, base, noise, threads, allocate)
    # Weights at first; `_order_samples` turns them into sums in place.
    area = np.empty(0) if cell_weight is None else cell_weight.astype(np.float64).reshape(-1)
    return Drainage(grid, h, base, to, _order_samples(grid, to, area, threads, allocate), area, allocate)


def _find_receivers(
    grid: kernels.Grid,
    h: np.ndarray,
    base: np.ndarray,
    noise: "routing.ReceiverNoise | None",
    threads: int,
    allocate: Allocate,
) -> np.ndarray:
    """Return the directions of all receivers, uint8 [n], also out of depressions and over flats.

    h: heights, float32 [n] metres. base: uint8 [n], 1 where water leaves. noise: random factors of slopes, None for
    none.
    """
    # `cross_flats` uses `order` as its queue, of which the system commits memory only for samples of flats. It counts
    # the pits, samples to which flats without an outlet drain, and gives them the labels 2, 3 ...
    to, queue, pits = allocate(h.shape, np.uint8), allocate(h.shape, np.int32), np.zeros(1, np.int32)
    label = allocate(h.shape, np.int32)
    label.fill(0)
    d = kernels.DrainageArrays()
    d.grid, d.h, d.base, d.to = grid, flat(h, wp.float32), flat(base, wp.uint8), flat(to, wp.uint8)
    d.label, d.order = flat(label, wp.int32), flat(queue, wp.int32)
    inputs = [d, _inverse_distances(grid, noise), noise or routing.ReceiverNoise()]
    spread = partial(launch.spread, step="routing", threads=threads)
    spread(routing.find_receivers, grid.height, inputs, cost=grid.width / 8)
    launch.once(routing.cross_flats, [d, flat(pits, wp.int32)], step="routing")
    if pits[0]:
        _link(d, int(pits[0]), threads, allocate)
    return to


def _order_samples(
    grid: kernels.Grid, to: np.ndarray, area: np.ndarray, threads: int, allocate: Allocate
) -> np.ndarray:
    """Return indices of samples with donors before receivers, int32 [n], and sum up areas downstream.

    to: directions of receivers, uint8 [n]. area: weights of samples, float64 [n], which become drainage areas in place;
    empty for none.
    """
    # `donors`: numbers of donors, counted down until a sample has none left and can follow them in the order.
    donors, order = allocate(to.shape, np.uint8), allocate(to.shape, np.int32)
    d = kernels.DrainageArrays()
    d.grid, d.to, d.donors, d.order = grid, flat(to, wp.uint8), flat(donors, wp.uint8), flat(order, wp.int32)
    if area.size:
        d.area = flat(area, wp.float64)
    launch.spread(routing.count_donors, grid.height, [d], step="routing", threads=threads, cost=grid.width / 16)
    launch.once(routing.order_downstream, [d], step="routing")
    return order


def _scratch_of_sort(count: int, allocate: Allocate) -> "list[wp.array]":
    """Return memory for a sort of `count` samples or passes: the last arguments `scratch` .. `starts` of its kernel."""
    halves, starts = allocate((count,), np.uint16), np.zeros(2 << 16, np.int32)
    return [flat(allocate((count,), np.int32), wp.int32), flat(halves, wp.uint16), flat(starts, wp.int32)]


def grid_of(rows: int, columns: int, step_x: float, step_y: float) -> kernels.Grid:
    """Return the size and the weights of a grid for kernels, by directions: along x, along y and diagonal.

    step_x, step_y: metres between samples. Its `inverse_distance` is 1 / distance of neighbours in a direction, `share`
    the length of contour that flow crosses, divided by that distance. rows, columns: samples.
    """
    grid, diagonal = kernels.Grid(), step_x * step_x + step_y * step_y
    grid.width, grid.height = columns, rows
    grid.inverse_distance = wp.vec3f(1.0 / step_x, 1.0 / step_y, diagonal**-0.5)
    # Length of contour over distance: half a side for the axes; for diagonals the value of Quinn et al. on squares.
    grid.share = wp.vec3d(0.5 * step_y / step_x, 0.5 * step_x / step_y, 0.5 * step_x * step_y / diagonal)
    return grid


def _inverse_distances(grid: kernels.Grid, noise: "routing.ReceiverNoise | None") -> wp.vec3f:
    """Return 1 / metres along x, along y and diagonally, for the choice of receivers.

    With noise, paths would turn towards diagonals and towards the longer steps. So the value of an axis is multiplied
    by the square root of the other axis's step over its own, and that of diagonals by DIAGONAL. noise: random factors
    of slopes; None, or without jitter, for none.
    """
    if noise is None or noise.jitter == 0.0:
        return grid.inverse_distance
    ew, ns, diagonal = grid.inverse_distance
    axes = math.sqrt(ew / ns)
    return wp.vec3f(ew * axes, ns / axes, DIAGONAL * diagonal)


def _link(d: kernels.DrainageArrays, pits: int, threads: int, allocate: Allocate) -> None:
    """Drain every basin that ends in a pit over its lowest pass into a neighbouring basin.

    Passes are counted first and listed then, to allocate their arrays. Sorted by height, they form a spanning tree of
    the basins. d: the drainage, changed in place. pits: number of basins.
    """
    width, height = d.grid.width, d.grid.height
    spread = partial(launch.spread, step="routing", threads=threads)
    # Label all samples by basin, BLOCK of them an item; `start`: number of passes in each row.
    spread(routing.label_basins, -(-width * height // BLOCK), [BLOCK, d], cost=BLOCK)
    start = np.zeros(height + 1, np.int64)

    def launch_search(emit: int, edge: np.ndarray) -> None:
        """Find the passes between basins: count them by rows into `start` (emit 0), or list them (emit 1).

        edge: a sample and the direction to the other one as a number, int32 (find_passes).
        """
        inputs = [emit, d, flat(start, wp.int64), flat(edge, wp.int32)]
        spread(routing.find_passes, height - 1, inputs, cost=width / 8)

    launch_search(emit=0, edge=np.empty(1, np.int32))
    # Numbers of passes by row become the number of the first pass of each row.
    start[1:] = np.cumsum(start[:-1])
    start[0] = 0
    count = int(start[-1])
    edge = allocate((count,), np.int32)
    launch_search(emit=1, edge=edge)
    scratch = _scratch_of_sort(count, allocate)
    launch.once(routing.sort_passes, [count, d, flat(edge, wp.int32), *scratch], step="routing")
    del scratch
    # Union-find: the parent of each basin, at first itself. Label 1 is all outlets; those of pits begin at 2.
    parents = np.arange(pits + 2, dtype=np.int32)
    launch.once(routing.link_basins, [count, pits, d, flat(edge, wp.int32), flat(parents, wp.int32)], step="routing")
