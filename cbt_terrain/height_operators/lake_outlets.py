# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlets of lakes at a finer level: those of the coarser level.

Finer samples may change which of two passes is the lower. A tile that lacks part of the shore cannot find the lowest,
so tiles and the whole level both take the outlets of the coarser level: water chooses its way as if a deep trench lay
along them. The ground itself is not trenched, since streams cut it. Only dams between two coarser samples of an outlet
are lowered, behind which a lake would rise and leave elsewhere.

The *path* is the samples of that trench (`Bed.path`) with the heights in metres of its bottom (`Bed.path_level`). LAKE
of a change's state is the depth of lakes in metres. A `Bed` is the state of this level or tile, arrays of n samples in
C order; its `fixed` samples do not change and let water leave.
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
    fixed, wet = bed.fixed.reshape(bed.shape)[coarse], coarser.state[LAKE][coarse] > 0.0  # wet: in a lake
    if not wet.any():
        return
    surface = floor + coarser.state[LAKE][coarse]
    # Water level along the path, and highest ground without dams; infinite away from the path.
    path_level, max_ground = (np.full(bed.shape, np.inf, np.float32) for _ in range(2))
    heights = bed.heights.reshape(bed.shape)

    def middle(here: Positions, after: Positions) -> Positions:
        """Return this level's samples halfway between neighbouring coarse samples, or at one that is given twice.

        here, after: rows and columns of the coarse samples.
        """
        # Coarse sample n is sample 2 n + start of this level, so halfway from n to m is n + m + start.
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
        """Limit the ground halfway between coarse samples to the higher of both ends, in `max_ground`.

        here, after: these samples, from upstream to downstream.
        """
        higher_end = np.maximum(heights[middle(here, here)], heights[middle(after, after)])
        np.minimum.at(max_ground, middle(here, after), higher_end)

    # Directions of receivers (`neighbour`; 4 for none), and drainage areas in samples of this level.
    to = route(surface, 2 * ground.step_x, 2 * ground.step_y, fixed, ground.threads).to.reshape(floor.shape)
    flow = coarser.layers["flow"][coarse] / np.float32(ground.step_x * ground.step_y)
    ends = _find_outlets(surface, wet, to, flow)  # of the paths so far, coarse rows and columns
    # Follow all paths downstream, by one coarse sample in each of LENGTH rounds.
    for _ in range(LENGTH):
        lower_path(ends, ends)
        below = neighbour(*ends, to[ends])
        lower_path(ends, below)
        breach_dams(ends, below)
        y, x = np.unique(np.stack(below)[:, to[ends] != 4], axis=1)  # a path ends where there is no receiver
        ends = y, x
    is_cut = np.zeros(bed.shape, bool)  # samples where a tile is cut out of the level, no border of the raster
    for side, is_border in zip(sides(bed.shape), ground.rims, strict=True):
        is_cut[side] |= not is_border
    unchanged = is_cut | bed.fixed.reshape(bed.shape)
    # Lower the dams, as far as the mask's weight allows.
    dams = np.isfinite(max_ground) & ~unchanged
    heights[dams] += np.minimum(max_ground - heights, np.float32(0.0))[dams] * bed.weight.reshape(bed.shape)[dams]
    bed.path = np.flatnonzero(np.isfinite(path_level) & ~unchanged)
    # The trench is so deep (WALL metres) that no other pass is lower.
    bed.path_level = path_level.reshape(-1)[bed.path] - np.float32(WALL)


def _find_outlets(surface: np.ndarray, wet: np.ndarray, to: np.ndarray, flow: np.ndarray) -> Positions:
    """Return rows and columns of outlets: dry samples next to a lake, no more than LEVEL metres above it.

    An outlet drains more than the lake's sample, and at least MIN_AREA. surface: heights of ground and water, metres.
    wet: bool, samples under a lake. to: direction of the receiver, 4 for none. flow: drainage area in samples.
    """
    y, x = np.nonzero(~wet & (to != 4) & (flow >= MIN_AREA))
    is_outlet = np.zeros(len(y), bool)
    for way in (0, 1, 2, 3, 5, 6, 7, 8):  # directions of all neighbours
        neighbours = neighbour(y, x, way)
        is_outlet |= (
            wet[neighbours]
            & (surface[neighbours] >= surface[y, x] - np.float32(LEVEL))
            & (flow[neighbours] < flow[y, x])
        )
    return y[is_outlet], x[is_outlet]
