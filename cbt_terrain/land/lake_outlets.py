# SPDX-License-Identifier: GPL-3.0-or-later
"""Lakes leave where they left at the coarser level: in a tile, which cannot see all of their shore, and in the whole.

Two passes out of a lake may be of nearly one height, and finer samples tell another order than every second one. So
where the coarser level's lakes run over, the choice of ways finds the ground lower than it is.
"""

import numpy as np

from ..effects.routing import route
from .fluvial import Bed
from .land_effect import Change, Ground
from .levels import finer

# What the next finer level is told: metres of water above the ground.
LAKE = "lake"
# Of the root mean square by which a level is rougher than the coarser one: other passes may be so much lower in it.
ROUGHNESS = 4.0
# Coarse samples of a way out at most.
FAR = 32
# Surfaces of a lake differ by less, metres, by rounding.
LEVEL = 0.01


def roughness(ground: Ground, odd: tuple[int, int]) -> float:
    """Root mean square of what the samples of a level tell of the heights beside every second one, metres."""
    part = ground.heights[odd[0] :, odd[1] :]
    rows, columns = (n - 1 + n % 2 for n in part.shape)
    part = part[:rows, :columns]
    rough = part - finer(np.ascontiguousarray(part[::2, ::2]), part.shape)
    return float(np.sqrt(np.mean(np.square(rough, dtype=np.float64))))


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
    free = to != 4
    at = np.flatnonzero(~wet & free)
    over = np.zeros(len(at), bool)
    for step in np.delete(away, 4):
        near = at + step
        over |= wet[near] & (surface[near] >= surface[at] - LEVEL) & (flow[near] < flow[at])
    at = at[over]
    higher = ROUGHNESS * roughness(ground, odd)
    lowest = surface[at] - np.float32(2 * higher)
    found, levels = [], []

    def put(j, i, level):
        found.append((2 * 0 + j) * bed.shape[1] + i)
        levels.append(level)

    for _ in range(FAR):
        y, x = np.divmod(at, columns)
        put(2 * y + odd[0], 2 * x + odd[1], surface[at])
        below = at + away[to[at]]
        put(2 * y + odd[0] + to[at] // 3 - 1, 2 * x + odd[1] + to[at] % 3 - 1, surface[below])
        on = free[below] & ~wet[below] & (surface[below] > lowest)
        at, lowest = below[on], lowest[on]
        if not len(at):
            break
    at, level = np.concatenate(found), np.concatenate(levels) - np.float32(higher)
    order = np.lexsort((level, at))
    at, first = np.unique(at[order], return_index=True)
    level = level[order][first]
    some = ~bed.fixed[at]
    bed.sills, bed.sill = at[some], level[some].astype(np.float32)
