# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of rivers over a whole level: rock is cut and creeps, what was taken is carried and laid down in part.

dh / dt = rise - K (A + A0)^(1/2) S + D lap h + deposition, slopes capped: stream power with a hillslope's area A0,
which makes it converge as the spacing shrinks (without it every halving adds as much relief as the last).
"""

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ...kernels.effects.routing import Draw
from ...kernels.land import creep as creep_kernels
from ...kernels.land import fluvial as kernels
from ..effects.routing import Drainage, grid_of, route
from ..run import launch
from ..run.buffers import flat

# Slopes count 0.2 to 1.8 times what they are, drawn anew in every step: without it D8 leaves straight lines and facets.
JITTER = 1.6
# Metres: the longest waves in which rock varies, and how many halvings of them; five octaves have a deviation of 1.
ROCK, ROCK_OCTAVES = 960.0, 5
# Of what an explicit step of diffusion may move at most, 0.5 being the limit of its stability.
CREEP = 0.4
# Squared samples over which a step of so many years creeps at least: what the noise has left of single samples is gone.
# The bends that the ground had before are not the noise's, and stay: else ridges of a rough range end as blurred spots.
LEAST_CREEP, CREEP_YEARS = 0.06, 5e3
# Metres of sediment that bury them.
BURIED = 1.0
# Beyond so many of them an implicit one is cheaper, of blocks of so many columns.
MOST_PASSES, BLOCK = 16, 64
# What lies under water settles, in so many passes a step between samples so far apart: streams bring it along single
# paths, which would show as worms, and where each of them runs is left to chance.
SETTLING, APART = 12, (4, 2, 1)


@dataclass(eq=False)
class Bed:
    """The state of a level, arrays of n samples in C order, and what drives it.

    `heights`: float32 metres. `sediment`: float32 metres, of the heights. `fixed`: bool, water leaves there, nothing
    changes. `part`: float32, 0 to 1, of the effect. `soft`: float32, the same times the rock's softness. `lift`:
    float32 metres a year. `own`: float64, samples that each counts for, with those beyond the cut of a tile. `first`,
    `seed`: of the noise, as a ground's. `bends`: float32, see `bends_of`, or 0. `rim`: numbers of samples of the rim
    where water leaves only when it has risen to `spill`, float32 metres. `brought`: float64, metres of sediment times
    samples that come over the cut of a tile in a year, or None. `low`: numbers of samples that stand no higher than
    `level`, float32 metres, when it is chosen where water goes (lake_outlets.py).
    """

    shape: tuple[int, int]
    step_x: float
    step_y: float
    heights: np.ndarray
    sediment: np.ndarray
    fixed: np.ndarray
    part: np.ndarray
    soft: np.ndarray
    lift: np.ndarray
    own: np.ndarray
    first: tuple[int, int] = (0, 0)
    seed: int = 0
    threads: int = 1
    bends: np.ndarray | float = 0.0
    rim: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    spill: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    brought: np.ndarray | None = None
    low: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    level: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))

    def drain(self, draw: "Draw | None" = None) -> Drainage:
        heights = self.heights + np.float32(0.0)
        heights[self.rim] = np.maximum(heights[self.rim], self.spill)
        chosen = heights.copy()
        chosen[self.low] = np.minimum(chosen[self.low], self.level)
        fixed = self.fixed.reshape(self.shape)
        drainage = route(chosen.reshape(self.shape), self.step_x, self.step_y, fixed, self.threads, draw, self.own)
        drainage.heights = heights
        return drainage


def step(bed: Bed, years: float, values: dict[str, float], number: int) -> np.ndarray | None:
    """Let `years` pass; `number`: of this step's draw of the noise. The parameters are those of rivers.py.

    float64 [n], metres times samples of sediment that came to each sample: at those where water leaves, what has left;
    None without deposition.
    """
    ground, drainage = bed.heights, bed.drain(_draw(bed, number))
    raised = drainage.heights if not bed.lift.any() else drainage.heights + np.float32(years) * bed.lift
    bed.heights = raised.copy()
    river, filled = _cut(bed, drainage, years, values)
    load = None if filled is None else _lay_down(bed, drainage, river, raised, filled, years)
    lifted = np.float32(years) * bed.lift[bed.rim]
    bed.heights[bed.rim] = raised[bed.rim] = ground[bed.rim] + lifted  # water stood higher there
    if values["creep"] > 0.0:
        _creep(bed, years, values["creep"], drainage.base, filled)
    bed.sediment = np.maximum(bed.sediment + (bed.heights - raised), np.float32(0.0))
    return load


def bends_of(bed: Bed) -> np.ndarray:
    """float32 [n], 1 / m: the Laplacian of the heights as they are, 0 along the rim and where nothing changes."""
    h, bends = bed.heights.reshape(bed.shape), np.zeros(bed.shape, np.float32)
    middle = h[1:-1, 1:-1]
    bends[1:-1, 1:-1] = ((h[1:-1, 2:] - middle) - (middle - h[1:-1, :-2])) / np.float32(bed.step_x**2)
    bends[1:-1, 1:-1] += ((h[2:, 1:-1] - middle) - (middle - h[:-2, 1:-1])) / np.float32(bed.step_y**2)
    return np.where(bed.fixed, np.float32(0.0), bends.reshape(-1))


def _creep(bed: Bed, years: float, rate: float, base: np.ndarray, filled: np.ndarray | None) -> None:
    """Diffusion at `rate` (m2 a year), and what LEAST_CREEP is more. Of that the ground's own bends are kept as far as
    they are still there: where they are bare, not where `filled` is the surface of a lake."""
    spread = years * rate
    more = max(LEAST_CREEP * bed.step_x * bed.step_y * min(years / CREEP_YEARS, 1.0) - spread, 0.0)
    bare = np.clip(1.0 - bed.sediment * np.float32(1.0 / BURIED), 0.0, 1.0, dtype=np.float32)
    if filled is not None:
        bare[filled > bed.heights] = 0.0
    bare *= np.float32(more) * bed.bends
    bed.heights = diffuse(bed, bed.heights, spread + more, base, bed.part, bare)


def vary_rock(bed: Bed, variety: float) -> None:
    """Make the rock softer here and harder there; `variety`: standard deviation of the logarithm."""
    grid = grid_of(*bed.shape, bed.step_x, bed.step_y)
    place = [wp.vec2i(*bed.first), wp.vec2d(bed.step_x, bed.step_y), ROCK, ROCK_OCTAVES]
    inputs = [grid, *place, 0.5 * variety, wp.uint32(bed.seed & 0xFFFFFFFF), flat(bed.soft, wp.float32)]
    rows, columns = bed.shape
    launch.spread(kernels.vary_rock, rows, inputs, step="rivers", threads=bed.threads, cost=6 * columns)


def _draw(bed: Bed, number: int) -> Draw:
    draw = Draw()
    draw.jitter, draw.seed = JITTER, (bed.seed * 0x9E3779B1 + number * 0x85EBCA77 + 1) & 0xFFFFFFFF
    draw.row, draw.column = bed.first
    return draw


def _cut(
    bed: Bed, drainage: Drainage, years: float, values: dict[str, float]
) -> tuple[kernels.River, np.ndarray | None]:
    """Returns the step so far and, where sediment is wanted, the water's surface."""
    r, rate, (rows, columns) = kernels.River(), np.empty_like(bed.heights), bed.shape
    filled = np.empty_like(rate) if values["deposition"] > 0.0 else None
    r.grid, r.lakes, r.deposition = drainage.grid, int(filled is not None), values["deposition"]
    r.cell, r.hillslope, r.strength = bed.step_x * bed.step_y, values["hillslope"], values["erodibility"] * years
    r.drop = wp.vec3f(*(np.tan(np.radians(values["steepest"])) / np.array([*drainage.grid.nearness])))
    r.to, r.order = flat(drainage.to, wp.uint8), flat(drainage.order, wp.int32)
    r.area = flat(drainage.catchments, wp.float64)
    r.soft, r.part, r.rate, r.h = (flat(a, wp.float32) for a in (bed.soft, bed.part, rate, bed.heights))
    r.filled = r.rate if filled is None else flat(filled, wp.float32)
    launch.spread(kernels.find_rates, rows, [r], step="rivers", threads=bed.threads, cost=columns / 8)
    launch.once(kernels.cut_down, [r], step="rivers")
    return r, filled


def diffuse(
    bed: Bed, values: np.ndarray, spread: float, still: np.ndarray, part: np.ndarray, kept: np.ndarray | None = None
) -> np.ndarray:
    """`values` (float32 [n], used up) after diffusion over `spread` m2, in as many explicit steps as are stable, or in
    an implicit one; `part` (float32 [n]) of it. Where `still` (uint8 [n], as all of the rim is) is 1 they stay. `kept`:
    float32 [n], metres that they do not move by where they would that way; only explicit steps heed it."""
    ew, ns = spread / bed.step_x**2, spread / bed.step_y**2
    passes = int(np.ceil((ew + ns) / CREEP))
    (rows, columns), other = bed.shape, values.copy()
    soil, common = creep_kernels.Soil(), {"step": "rivers", "threads": bed.threads}
    soil.grid = grid_of(rows, columns, bed.step_x, bed.step_y)
    soil.base, soil.part = flat(still, wp.uint8), flat(part, wp.float32)
    if passes > MOST_PASSES:
        soil.ew, soil.ns = ew, ns
        soil.scratch, soil.change, soil.h = (flat(a, wp.float32) for a in (other, np.empty_like(values), values))
        blocks = -(-columns // BLOCK)
        launch.spread(creep_kernels.creep_along_columns, blocks, [BLOCK, soil], cost=BLOCK * rows / 8, **common)
        launch.spread(creep_kernels.creep_along_rows, rows, [soil], cost=columns, **common)
        return values
    soil.ew, soil.ns = ew / max(passes, 1), ns / max(passes, 1)
    soil.kept = flat(np.zeros_like(values) if kept is None else kept / np.float32(max(passes, 1)), wp.float32)
    for _ in range(passes):
        soil.old, soil.h = flat(values, wp.float32), flat(other, wp.float32)
        launch.spread(creep_kernels.creep, rows - 2, [soil], cost=columns / 16, **common)
        values, other = other, values
    return values


def _lay_down(
    bed: Bed, drainage: Drainage, river: kernels.River, raised: np.ndarray, filled: np.ndarray, years: float
) -> np.ndarray:
    load = np.zeros(len(filled)) if bed.brought is None else bed.brought * years
    lake = (filled > bed.heights) & (drainage.base == 0) & (bed.part > 0.0)
    river.before, river.load = flat(raised, wp.float32), flat(load, wp.float64)
    launch.once(kernels.lay_down, [river], step="rivers")
    _settle(bed, lake, raised)
    return load


def _settle(bed: Bed, lake: np.ndarray, raised: np.ndarray) -> None:
    """Level out what has been laid down where there is a `lake` (bool [n], none of the rim), until now and just now."""
    at = np.flatnonzero(lake)
    was = np.maximum(bed.sediment[at] + (bed.heights[at] - raised[at]), np.float32(0.0))
    rock, old, new = (np.zeros(len(lake), np.float32) for _ in range(3))
    rock[at], old[at], new[at] = bed.heights[at] - was, was, was
    for apart in APART:
        open_water = _inside(lake.reshape(bed.shape), apart - 1).reshape(-1)
        wide = np.flatnonzero(open_water)
        ends = np.flatnonzero(np.diff(wide // bed.shape[1], append=-1))
        last = wide[ends].astype(np.int32)
        first = wide[np.append(0, ends[:-1] + 1)[: len(ends)]].astype(np.int32)
        where = [bed.shape[1], apart, flat(first, wp.int32), flat(last, wp.int32)]
        where.append(flat(open_water.view(np.uint8), wp.uint8))
        cost = len(wide) / max(len(ends), 1) / 8
        for _ in range(SETTLING if len(ends) else 0):
            arrays = [flat(a, wp.float32) for a in (rock, old, new)]
            launch.spread(kernels.settle, len(ends), [*where, *arrays], step="rivers", threads=bed.threads, cost=cost)
            old, new = new, old
    bed.heights[at] += old[at] - was


def _inside(lake: np.ndarray, far: int) -> np.ndarray:
    """bool [rows, columns]: samples of a lake, none of which is of the rim, with water all round, so far."""
    inside = lake
    for axis in (0, 1) if far else ():
        inside = np.logical_and.reduce([np.roll(inside, by, axis) for by in range(-far, far + 1)])
    return inside
