# SPDX-License-Identifier: GPL-3.0-or-later
"""Lakes leave where they left at the coarser level.

Of two passes out of a lake that are of nearly one height, the lower one may be another among finer samples. A tile that
does not see all of the shore has to ask the coarser level; so the whole does, too. Where water left there, the choice
of ways finds a trench, as deep as the ground will not be. The ground itself stays, for streams to cut, but for dams
between two coarser samples of the way: behind them a lake would stand higher, and leave as no other tile expects.
"""

import numpy as np

from ..effects.routing import route
from .fluvial import Bed
from .land_effect import Change, Ground
from .river_rims import LAKE, LEVEL, WALL

# Coarse samples along a way out: far enough down that no other pass is lower than its end.
FAR = 32
# Samples that drain through an outlet, at least: of smaller lakes a tile sees the shore, and judges as the whole.
LEAST = 96**2


def keep_outlets(bed: Bed, ground: Ground, coarser: Change) -> None:
    """Tell the bed which samples count as low ground in the choice of ways: those along the outlets of lakes. Its
    heights are lowered where there are dams."""
    every = tuple(slice(first % 2, None, 2) for first in ground.first)
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[every])
    fixed, wet = bed.fixed.reshape(bed.shape)[every], coarser.kept[LAKE][every] > 0.0
    if not wet.any():
        return
    surface = floor + coarser.kept[LAKE][every]
    to = route(surface, 2 * ground.step_x, 2 * ground.step_y, fixed, ground.threads).to.reshape(floor.shape)
    flow = coarser.layers["flow"][every] / np.float32(ground.step_x * ground.step_y)
    found, free = (np.full(bed.shape, np.inf, np.float32) for _ in range(2))
    heights, y, x = bed.heights.reshape(bed.shape), *_overflows(surface, wet, to, flow)

    def lower(half: int, after) -> None:
        """The ground halfway on; floors of lakes only where they are yet to be cut down below the water."""
        way, water = to[y, x].astype(np.int64), wet[y, x] | wet[after]
        j, i = (2 * n + s.start + half * a for n, s, a in zip((y, x), every, (way // 3 - 1, way % 3 - 1), strict=True))
        level = surface[after]
        some = ~water | (heights[j, i] > level)
        np.minimum.at(found, (j[some], i[some]), level[some])

    def breach(after) -> None:
        """Halfway on the ground is no higher than at both ends."""
        ends = [tuple(2 * n + s.start for n, s in zip(at, every, strict=True)) for at in ((y, x), after)]
        halfway = tuple((a + b) // 2 for a, b in zip(*ends, strict=True))
        np.minimum.at(free, halfway, np.maximum(*(heights[end] for end in ends)))

    for _ in range(FAR):
        lower(0, (y, x))
        below = y + to[y, x] // 3 - 1, x + to[y, x] % 3 - 1
        lower(1, below)
        breach(below)
        y, x = np.unique(np.stack(below)[:, to[y, x] != 4], axis=1)
    cut = np.zeros(bed.shape, bool)
    for side, rim in zip((np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]), ground.rims, strict=True):
        cut[side] |= not rim
    stays = cut | bed.fixed.reshape(bed.shape)
    dams = np.isfinite(free) & ~stays
    heights[dams] += np.minimum(free - heights, np.float32(0.0))[dams] * bed.part.reshape(bed.shape)[dams]
    bed.low = np.flatnonzero(np.isfinite(found) & ~stays)
    bed.level = found.reshape(-1)[bed.low] - np.float32(WALL)


def _overflows(surface, wet, to, flow) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the samples over which lakes leave: dry, beside water of their height, with its catchment."""
    y, x = np.nonzero(~wet & (to != 4) & (flow >= LEAST))
    over = np.zeros(len(y), bool)
    for way in (0, 1, 2, 3, 5, 6, 7, 8):
        near = y + way // 3 - 1, x + way % 3 - 1
        over |= wet[near] & (surface[near] >= surface[y, x] - np.float32(LEVEL)) & (flow[near] < flow[y, x])
    return y[over], x[over]
