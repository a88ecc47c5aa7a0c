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
    """Set the bed's path to the samples along the outlets of lakes, and lower its heights where there are dams.

    Without lakes the bed stays. coarser: the coarser level's change, interpolated to `ground`.
    """
    coarse = tuple(slice(first % 2, None, 2) for first in ground.first)  # the coarser level's samples
    floor = np.ascontiguousarray((ground.heights + coarser.heights)[coarse])
    fixed, wet = bed.fixed.reshape(bed.shape)[coarse], coarser.state[LAKE][coarse] > 0.0
    if not wet.any():
        return
    surface = floor + coarser.state[LAKE][coarse]
    # Directions of receivers (`neighbour`; 4 for none), and drainage areas in samples of this level.
    to = route(surface, 2 * ground.step_x, 2 * ground.step_y, fixed, ground.threads).to.reshape(floor.shape)
    flow = coarser.layers["flow"][coarse] / np.float32(ground.step_x * ground.step_y)
    path_level, max_ground = (np.full(bed.shape, np.inf, np.float32) for _ in range(2))
    heights = bed.heights.reshape(bed.shape)

    def middle(here: Positions, after: Positions) -> Positions:
        """Return this level's samples halfway between neighbouring coarse samples, or at one that is given twice.

        here, after: rows and columns of the coarse samples.
        """
        j, i = (n + m + s.start for n, m, s in zip(here, after, coarse, strict=True))
        return j, i

    def lower_path(here: Positions, after: Positions) -> None:
        """Lower the path halfway between coarse samples to the surface at `after`; `here`: those upstream.

        Under lakes it is lowered only where the floor is above that surface.
        """
        (j, i), outflow_level = middle(here, after), surface[after]
        lowered = ~(wet[here] | wet[after]) | (heights[j, i] > outflow_level)
        np.minimum.at(path_level, (j[lowered], i[lowered]), outflow_level[lowered])

    def breach_dams(here: Positions, after: Positions) -> None:
        """Limit the ground halfway between coarse samples to the higher of both ends.

        here, after: these samples, from upstream to downstream.
        """
        higher_end = np.maximum(heights[middle(here, here)], heights[middle(after, after)])
        np.minimum.at(max_ground, middle(here, after), higher_end)

    ends = _find_outlets(surface, wet, to, flow)  # of the paths so far, coarse rows and columns
    for _ in range(LENGTH):
        lower_path(ends, ends)
        below = neighbour(*ends, to[ends])
        lower_path(ends, below)
        breach_dams(ends, below)
        y, x = np.unique(np.stack(below)[:, to[ends] != 4], axis=1)  # a path ends where there is no receiver
        ends = y, x
    is_cut = np.zeros(bed.shape, bool)  # samples where a tile is cut out of the level
    for side, is_border in zip(sides(bed.shape), ground.rims, strict=True):
        is_cut[side] |= not is_border
    unchanged = is_cut | bed.fixed.reshape(bed.shape)
    dams = np.isfinite(max_ground) & ~unchanged
    heights[dams] += np.minimum(max_ground - heights, np.float32(0.0))[dams] * bed.weight.reshape(bed.shape)[dams]
    bed.path = np.flatnonzero(np.isfinite(path_level) & ~unchanged)
    # The trench is so deep that no other pass is lower.
    bed.path_level = path_level.reshape(-1)[bed.path] - np.float32(WALL)


def _find_outlets(surface: np.ndarray, wet: np.ndarray, to: np.ndarray, flow: np.ndarray) -> Positions:
    """Return rows and columns of outlets: dry samples next to a lake of their height, which drain more.

    They drain at least MIN_AREA. surface: heights of ground and water, metres. wet: bool, samples under a lake. to:
    direction of the receiver, 4 for none. flow: drainage area in samples.
    """
    y, x = np.nonzero(~wet & (to != 4) & (flow >= MIN_AREA))
    is_outlet = np.zeros(len(y), bool)
    for way in (0, 1, 2, 3, 5, 6, 7, 8):
        neighbours = neighbour(y, x, way)
        is_outlet |= (
            wet[neighbours]
            & (surface[neighbours] >= surface[y, x] - np.float32(LEVEL))
            & (flow[neighbours] < flow[y, x])
        )
    return y[is_outlet], x[is_outlet]
