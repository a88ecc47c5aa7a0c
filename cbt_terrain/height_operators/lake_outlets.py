# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlets of lakes at a finer level: those of the coarser level.

Of two passes of nearly one height another one may be the lower among finer samples. A tile that does not contain the
whole shore relies on the coarser level, and so does the whole. The choice of receivers sees a deep trench along the
coarser outlet. The ground does not change, since streams cut it, except for dams between two coarser samples of the
outlet, behind which a lake would rise and leave elsewhere.
"""

import numpy as np

from ..attributes.routing import route
from .fluvial import Bed
from .height_operator import Change, OperatorGround
from .river_borders import LAKE, LEVEL, WALL, Positions, neighbour, sides

# Coarse samples along an outlet: enough that no other pass is lower than its end.
LENGTH = 32
# Least drainage area of an outlet in samples. A tile contains the whole shore of smaller lakes.
MIN_AREA = 96**2


def keep_outlets(bed: Bed, ground: OperatorGround, coarser: Change) -> None:
    """Set the bed's path to the samples along the outlets of lakes, and lower its heights where there are dams."""
    every = tuple(slice(first % 2, None, 2) for first in ground.first)
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[every])
    fixed, wet = bed.fixed.reshape(bed.shape)[every], coarser.state[LAKE][every] > 0.0
    if not wet.any():
        return
    surface = floor + coarser.state[LAKE][every]
    to = route(surface, 2 * ground.step_x, 2 * ground.step_y, fixed, ground.threads).to.reshape(floor.shape)
    flow = coarser.layers["flow"][every] / np.float32(ground.step_x * ground.step_y)
    found, free = (np.full(bed.shape, np.inf, np.float32) for _ in range(2))
    heights, y, x = bed.heights.reshape(bed.shape), *_find_outlets(surface, wet, to, flow)

    def lower(half: int, after: Positions) -> None:
        """Lower the path at a sample or halfway to the next; under lakes only where the floor is above the level."""
        way, water = to[y, x].astype(np.int64), wet[y, x] | wet[after]
        j, i = (2 * n + s.start + half * a for n, s, a in zip((y, x), every, (way // 3 - 1, way % 3 - 1), strict=True))
        level = surface[after]
        some = ~water | (heights[j, i] > level)
        np.minimum.at(found, (j[some], i[some]), level[some])

    def breach(after: Positions) -> None:
        """Limit the ground halfway to the heights of both ends."""
        ends = [tuple(2 * n + s.start for n, s in zip(at, every, strict=True)) for at in ((y, x), after)]
        halfway = tuple((a + b) // 2 for a, b in zip(*ends, strict=True))
        np.minimum.at(free, halfway, np.maximum(*(heights[end] for end in ends)))

    for _ in range(LENGTH):
        lower(half=0, after=(y, x))
        below = neighbour(y, x, to[y, x])
        lower(half=1, after=below)
        breach(below)
        y, x = np.unique(np.stack(below)[:, to[y, x] != 4], axis=1)
    cut = np.zeros(bed.shape, bool)
    for side, border in zip(sides(bed.shape), ground.rims, strict=True):
        cut[side] |= not border
    constant = cut | bed.fixed.reshape(bed.shape)
    dams = np.isfinite(free) & ~constant
    heights[dams] += np.minimum(free - heights, np.float32(0.0))[dams] * bed.weight.reshape(bed.shape)[dams]
    bed.path = np.flatnonzero(np.isfinite(found) & ~constant)
    bed.path_level = found.reshape(-1)[bed.path] - np.float32(WALL)


def _find_outlets(surface: np.ndarray, wet: np.ndarray, to: np.ndarray, flow: np.ndarray) -> Positions:
    """Return rows and columns of outlets: dry samples beside a lake of their height, with its drainage area.

    surface: heights of ground and water, metres. wet: bool, samples under a lake. to: direction of the receiver, 4 for
    none. flow: drainage area in samples.
    """
    y, x = np.nonzero(~wet & (to != 4) & (flow >= MIN_AREA))
    over = np.zeros(len(y), bool)
    for way in (0, 1, 2, 3, 5, 6, 7, 8):
        near = neighbour(y, x, way)
        over |= wet[near] & (surface[near] >= surface[y, x] - np.float32(LEVEL)) & (flow[near] < flow[y, x])
    return y[over], x[over]
