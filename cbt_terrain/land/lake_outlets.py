# SPDX-License-Identifier: GPL-3.0-or-later
"""Lakes leave where they left at the coarser level: in a tile, which cannot see all of their shore, and in the whole.

Two passes out of a lake may be of nearly one height, and finer samples tell another order than every second one. So
where the coarser level's lakes run over, the choice of ways finds the ground lower than it is.
"""

import numpy as np

from ..effects.routing import route
from .fluvial import Bed
from .land_effect import Change, Ground

# What the next finer level is told: metres of water above the ground.
LAKE = "lake"
# Coarse samples of a way out at most.
FAR = 32
# Surfaces of a lake differ by less, metres, by rounding.
LEVEL = 0.01


WALL = np.float32(1e4)
LEAST = 48**2


def keep_outlets(bed: Bed, ground: Ground, coarser: Change) -> None:
    odd = tuple(first % 2 for first in ground.first)
    every = tuple(slice(n, None, 2) for n in odd)
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[every])
    lake, fixed = coarser.kept[LAKE][every], bed.fixed.reshape(bed.shape)[every]
    flow = np.ascontiguousarray(coarser.layers["flow"][every]).reshape(-1)
    surface, wet = floor + lake, (lake > 0.0).reshape(-1)
    if not wet.any():
        return
    to = route(surface, 2 * ground.step_x, 2 * ground.step_y, fixed, ground.threads).to.astype(np.int64)
    surface, columns = surface.reshape(-1), floor.shape[1]
    away = (np.arange(9) // 3 - 1) * columns + np.arange(9) % 3 - 1
    base = to == 4
    cell = ground.step_x * ground.step_y
    at = np.flatnonzero(~wet & ~base & (flow >= LEAST * cell))
    over = np.zeros(len(at), bool)
    for step in np.delete(away, 4):
        near = at + step
        over |= wet[near] & (surface[near] >= surface[at] - LEVEL) & (flow[near] < flow[at])
    at = at[over]
    found, levels, under = [], [], []
    for _ in range(FAR):
        y, x = np.divmod(at, columns)
        j, i = 2 * y + odd[0], 2 * x + odd[1]
        below = at + away[to[at]]
        found += [j * bed.shape[1] + i, (j + to[at] // 3 - 1) * bed.shape[1] + i + to[at] % 3 - 1]
        levels += [surface[at], surface[below]]
        under += [wet[at], wet[at] | wet[below]]
        at = np.unique(below[~base[at]])
        if not len(at):
            break
    at, level, under = map(np.concatenate, (found, levels, under))
    order = np.lexsort((level, at))
    at, first = np.unique(at[order], return_index=True)
    level, under = level[order][first], under[order][first]
    some = ~bed.fixed[at] & (~under | (bed.heights[at] > level))
    (rows, columns), (south, north, west, east) = bed.shape, ground.rims
    j, i = np.divmod(at, columns)
    some &= ((j > 0) | south) & ((j < rows - 1) | north) & ((i > 0) | west) & ((i < columns - 1) | east)
    bed.sills, bed.sill = at[some], (level - WALL)[some].astype(np.float32)
