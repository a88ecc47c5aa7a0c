# SPDX-License-Identifier: GPL-3.0-or-later
"""Drainage of a whole raster: receivers, order, filled surface and areas. The methods stand in kernels/effects."""

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.effects import catchment, routing
from ...kernels.effects import rows as kernels
from ..run import launch
from ..run.buffers import flat

BLOCK = 1 << 16
# With noise in the choice of receivers, slopes along diagonals count so much. Steps along them are 1.4 times as long:
# the mean way down a plane would turn to a diagonal by up to 3.5 degrees, and rills along such ways by up to 10. With
# this a way turns by 1.3 at most, where samples lie in squares. (Rho8 of Fairfield and Leymarie 1991 has the same end.)
# Where samples do not lie in squares, steps along the axes differ in length, too: a slope counts by the root of the
# other axis' over its own. The mean way down a plane then turns by 3 degrees (rms) of samples 2 : 1 and by 5 of 3 : 1,
# by 13 and 20 without; valleys, which dig, lean towards the longer steps by 9 and 10, not 12 and 16. A power of 3 / 4
# makes that 7 and 8, and ways 6 and 10; but then more straight valleys run along the shorter steps.
DIAGONAL = 0.86


@dataclass(eq=False)
class Drainage:
    """Where the water of a raster goes; arrays of n samples in C order.

    `to`: uint8, the receiver as a direction 3 * (dy + 1) + dx + 1, 4 for a root, all of which are of `base`: uint8, 1
    where water leaves. `order`: int32, samples after those that flow to them. `heights`: float32.
    `catchments`: float64, how many samples drain through each, all along its one receiver.
    """

    grid: kernels.Grid
    heights: np.ndarray
    base: np.ndarray
    to: np.ndarray
    order: np.ndarray
    catchments: np.ndarray

    def packed(self, filled: np.ndarray) -> kernels.Drainage:
        """As kernels read it; memory is shared. filled: float32 [n]."""
        d = kernels.Drainage()
        d.grid, d.to, d.order = self.grid, flat(self.to, wp.uint8), flat(self.order, wp.int32)
        d.h, d.filled = flat(self.heights, wp.float32), flat(filled, wp.float32)
        return d

    def filled(self) -> np.ndarray:
        """float32 [n] metres: the least surface, nowhere below the heights, from which every sample drains."""
        out = np.empty_like(self.heights)
        launch.once(catchment.fill_lakes, [self.packed(out)], step="routing")
        return out

    def areas(self, filled: np.ndarray) -> np.ndarray:
        """float64 [n]: how many samples drain through each, by multiple flow directions; nothing is lost."""
        count, d = len(self.to), self.packed(filled)
        key, item = np.empty(2 * count, np.float32), np.empty(2 * count, np.int32)
        item[:count] = self.order[::-1]  # receivers before donors
        np.take(filled, item[:count], out=key[:count])
        launch.sort_pairs(key, item, count, step="routing")
        area = np.ones(count)
        d.area = flat(area, wp.float64)
        launch.once(catchment.gather_area, [d, flat(item, wp.int32)], step="routing")
        return area

    def level_lakes(self, filled: np.ndarray, area: np.ndarray) -> None:
        """Give all that is below the surface of a lake the area of its outlet."""
        d = self.packed(filled)
        d.area = flat(area, wp.float64)
        launch.once(catchment.level_lakes, [d], step="routing")


def route(
    heights: np.ndarray,
    step_x: float,
    step_y: float,
    holes: np.ndarray | None = None,
    threads: int = 1,
    draw: "routing.Draw | None" = None,
    own: np.ndarray | None = None,
) -> Drainage:
    """The drainage of float32 [rows, columns] metres, samples so many metres apart.

    Water leaves at the rim and where `holes` (bool, of the same shape) are; depressions are cut through at their lowest
    passes, and flats drain along the shortest ways. `draw`: noise in the choice of receivers, if any. `own`: float64 of
    the same shape, what each sample counts for in `catchments`. A function of the arguments alone but for `threads`.
    """
    rows, columns = heights.shape
    base = np.zeros(heights.shape, np.uint8) if holes is None else holes.astype(np.uint8)
    base[[0, -1]] = 1
    base[:, [0, -1]] = 1
    base = base.reshape(-1)
    h = heights.reshape(-1) + np.float32(0.0)  # a sort tells -0 from 0
    count, pits = len(h), np.zeros(1, np.int32)
    to, donors, order = (np.empty(count, kind) for kind in (np.uint8, np.uint8, np.int32))
    d = kernels.Drainage()
    d.grid = grid = grid_of(rows, columns, step_x, step_y)
    d.h, d.base, d.to, d.donors = flat(h, wp.float32), *(flat(a, wp.uint8) for a in (base, to, donors))
    d.label, d.order = flat(np.zeros(count, np.int32), wp.int32), flat(order, wp.int32)
    work = {"step": "routing", "threads": threads}
    inputs = [d, _nearness(grid, draw), draw or routing.Draw()]
    launch.spread(routing.find_receivers, rows, inputs, cost=columns / 8, **work)
    launch.once(routing.cross_flats, [d, flat(pits, wp.int32)], step="routing")
    if pits[0]:
        _link(d, int(pits[0]), threads)
    launch.spread(routing.count_donors, rows, [d], cost=columns / 16, **work)
    area = np.ones(count) if own is None else own.astype(np.float64).reshape(-1)
    d.area = flat(area, wp.float64)
    launch.once(routing.order_downstream, [d], step="routing")
    return Drainage(grid, h, base, to, order, area)


def grid_of(rows: int, columns: int, step_x: float, step_y: float) -> kernels.Grid:
    """Rows, columns and weights by direction of samples so many metres apart."""
    grid, diagonal = kernels.Grid(), step_x * step_x + step_y * step_y
    grid.width, grid.height = columns, rows
    grid.nearness = wp.vec3f(1.0 / step_x, 1.0 / step_y, diagonal**-0.5)
    # Length of contour over distance: half a side's for the axes, for diagonals the part that makes squares Quinn's.
    grid.share = wp.vec3d(0.5 * step_y / step_x, 0.5 * step_x / step_y, 0.5 * step_x * step_y / diagonal)
    return grid


def _nearness(grid: kernels.Grid, draw: "routing.Draw | None") -> wp.vec3f:
    """One over the distance by direction, as receivers are chosen by it."""
    if draw is None or draw.jitter == 0.0:
        return grid.nearness
    ew, ns, across = grid.nearness
    axes = math.sqrt(ew / ns)
    return wp.vec3f(ew * axes, ns / axes, DIAGONAL * across)


def _link(d: kernels.Drainage, pits: int, threads: int) -> None:
    """Turn the flow of every basin that ends in a pit to the basin beyond its lowest pass."""
    width, height = d.grid.width, d.grid.height
    work = {"step": "routing", "threads": threads}
    launch.spread(routing.label_basins, -(-width * height // BLOCK), [BLOCK, d], cost=BLOCK, **work)
    start = np.zeros(height + 1, np.int64)

    def find(emit: int, key: np.ndarray, edge: np.ndarray) -> None:
        inputs = [emit, d, flat(start, wp.int64), flat(key, wp.float32), flat(edge, wp.int32)]
        launch.spread(routing.find_passes, height - 1, inputs, cost=width / 8, **work)

    find(0, np.empty(1, np.float32), np.empty(1, np.int32))
    start[1:] = np.cumsum(start[:-1])
    start[0] = 0
    count = int(start[-1])
    key, edge = np.empty(2 * count, np.float32), np.empty(2 * count, np.int32)
    find(1, key, edge)
    launch.sort_pairs(key, edge, count, step="routing")
    up = np.arange(pits + 2, dtype=np.int32)
    launch.once(routing.link_basins, [count, pits, d, flat(edge, wp.int32), flat(up, wp.int32)], step="routing")
