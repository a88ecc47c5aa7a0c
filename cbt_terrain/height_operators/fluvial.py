# SPDX-License-Identifier: GPL-3.0-or-later
"""A step of rivers over a level: uplift, stream-power incision, deposition and hillslope diffusion.

    dh / dt = U - K (A + A0)^m S^n + G / A Q_s + D lap h,  m = 1/2, n = 1, slopes up to `steepest`

h: height, U: uplift, K: erodibility, A: drainage area, S: slope to the receiver, Q_s: sediment flux, G: deposition, D:
creep. Incision is the implicit step of Braun and Willett (2013), deposition follows Davy and Lague (2009). The area A0
of a hillslope makes the result converge with the spacing; without it every halving adds as much relief as the last.
Boundaries: `fixed` samples keep their heights and let water leave; at `border` samples water leaves above
`outlet_level`.

A `Drainage` is where water flows: `to`, direction of each sample's receiver; `order`, samples with donors before
receivers; `catchments`, drainage areas in samples; `base`, 1 where water leaves (border and fixed samples).
`launch.spread` runs a kernel for a number of items, each of which takes `cost` times 15 ns; `launch.once` for one item.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import warp as wp

from ...kernels.effects.routing import ReceiverNoise
from ...kernels.land import creep as creep_kernels
from ...kernels.land import fluvial as kernels
from ..attributes.routing import Drainage, grid_of, route
from ..run import launch
from ..run.buffers import flat

# Receivers are chosen by slopes times a random factor of 0.2 to 1.8, drawn in every step. Without it D8 leaves straight
# lines and facets.
JITTER = 1.6
# Longest wave of the rock's variation in metres, and its octaves; five have a standard deviation of 1.
ROCK, ROCK_OCTAVES = 960.0, 5
# Diffusion number of an explicit step, whose limit of stability is 0.5.
CREEP = 0.4
# Least diffusion of a step of CREEP_YEARS, in squared samples; it removes the noise of single samples. The curvature
# that the ground had before the operator is not noise and is preserved, else ridges of a rough range blur.
MIN_CREEP, CREEP_YEARS = 0.06, 5e3
# Metres of sediment that bury the ground's curvature.
BURIED = 1.0
# More explicit steps than this cost more than an implicit one, whose work items are blocks of columns.
MAX_ROUNDS, BLOCK = 16, 64
# Pairs of passes of settling under water in a step, for each distance in samples. Streams deposit along single random
# paths, which would show as worms.
SETTLING, APART = 6, (4, 2, 1)
# Dry samples between two segments of lakes; fewer are cheaper to compute than to skip.
GAP = 8


@dataclass(eq=False)
class Bed:
    """The state of a level and its boundary conditions, arrays of n samples in C order.

    Attributes:
        shape: rows and columns; samples are `step_x` and `step_y` metres apart.
        heights, sediment: float32 metres; heights include sediment.
        fixed: bool, samples that let water leave and do not change.
        weight: float32, 0 to 1, the mask.
        erodibility: float32, factor on K: the mask times the rock's variation.
        uplift: float32, U in m/year.
        cell_weight: float64, upstream samples a sample stands for, including those outside the tile.
        first: row and column of the first sample in the whole level, which places the noise.
        seed: the noise's seed.
        curvature: float32 1/m, Laplacian of the ground's heights at first, which creep preserves; or 0.
        border, outlet_level: indices of border samples, and the float32 level in metres where water leaves there.
        inflow: float64, sediment that enters the tile, metres times samples a year, or None.
        path, path_level: indices and float32 levels in metres of samples that count as no higher in the choice of
            receivers (lake_outlets.py).
    """

    shape: tuple[int, int]
    step_x: float
    step_y: float
    heights: np.ndarray
    sediment: np.ndarray
    fixed: np.ndarray
    weight: np.ndarray
    erodibility: np.ndarray
    uplift: np.ndarray
    cell_weight: np.ndarray
    first: tuple[int, int] = (0, 0)
    seed: int = 0
    threads: int = 1
    curvature: np.ndarray | float = 0.0
    border: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    outlet_level: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    inflow: np.ndarray | None = None
    path: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    path_level: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))

    def drain(self, noise: "ReceiverNoise | None" = None) -> Drainage:
        """Route water over the bed with its boundary conditions; noise: of the choice of receivers, None for none.

        The `heights` of the result are those of the bed, at the border at least `outlet_level`. The lower path of lake
        outlets affects only the choice of receivers.
        """
        heights = self.heights + np.float32(0.0)  # a copy with 0 for -0, as `route` makes
        heights[self.border] = np.maximum(heights[self.border], self.outlet_level)
        chosen = heights.copy()
        chosen[self.path] = np.minimum(chosen[self.path], self.path_level)
        fixed, steps = self.fixed.reshape(self.shape), (self.step_x, self.step_y)
        drainage = route(chosen.reshape(self.shape), *steps, fixed, self.threads, noise, self.cell_weight)
        drainage.heights = heights
        return drainage


def step(bed: Bed, years: float, values: Mapping[str, float], number: int) -> np.ndarray | None:
    """Advance the bed's heights and sediment by `years`; `number` selects the noise of the receivers.

    values: parameters of rivers.py. Return the sediment that reached each sample (at outlets: that has left), float64
    [n], metres times samples; None without deposition.
    """
    before, drainage = bed.heights, bed.drain(_noise_of_step(bed, number))
    raised = drainage.heights if not bed.uplift.any() else drainage.heights + np.float32(years) * bed.uplift
    bed.heights = raised.copy()
    # `river`: the kernels' arrays, which deposition uses, too. Without deposition no surface is computed.
    river, water_surface = _incise(bed, drainage, years, values)
    load = None if water_surface is None else _deposit(bed, drainage, river, raised, water_surface, years)
    uplift = np.float32(years) * bed.uplift[bed.border]
    bed.heights[bed.border] = raised[bed.border] = before[bed.border] + uplift  # was raised to outlet_level
    if values["creep"] > 0.0:
        _creep(bed, years, values["creep"], drainage.base, water_surface)
    bed.sediment = np.maximum(bed.sediment + (bed.heights - raised), np.float32(0.0))
    return load


def curvature_of(bed: Bed) -> np.ndarray:
    """Return the Laplacian of the heights, float32 [n], 1/m, 0 along the border and at fixed samples."""
    h, laplacian = bed.heights.reshape(bed.shape), np.zeros(bed.shape, np.float32)
    middle = h[1:-1, 1:-1]  # differences to it are small numbers, which float32 rounds less than sums of heights
    laplacian[1:-1, 1:-1] = ((h[1:-1, 2:] - middle) - (middle - h[1:-1, :-2])) / np.float32(bed.step_x**2)
    laplacian[1:-1, 1:-1] += ((h[2:, 1:-1] - middle) - (middle - h[:-2, 1:-1])) / np.float32(bed.step_y**2)
    return np.where(bed.fixed, np.float32(0.0), laplacian.reshape(-1))


def _creep(bed: Bed, years: float, rate: float, base: np.ndarray, filled: np.ndarray | None) -> None:
    """Diffuse the bed's heights at `rate`, m2 a year, during `years`.

    The product is raised to at least MIN_CREEP squared samples (less in steps shorter than CREEP_YEARS). The added part
    does not smooth the ground's initial curvature, where no sediment or lake covers the ground. base: uint8 [n], 1
    where heights stay. filled: float32 [n] m, surface of lakes, or None.
    """
    spread = years * rate
    surplus = max(MIN_CREEP * bed.step_x * bed.step_y * min(years / CREEP_YEARS, 1.0) - spread, 0.0)
    # The fraction of bare ground; below, the change in metres that it preserves.
    preserved = np.clip(1.0 - bed.sediment * np.float32(1.0 / BURIED), 0.0, 1.0, dtype=np.float32)
    if filled is not None:
        preserved[filled > bed.heights] = 0.0
    preserved *= np.float32(surplus) * bed.curvature
    bed.heights = diffuse(bed, bed.heights, spread + surplus, base, bed.weight, preserved)


def vary_rock(bed: Bed, variety: float) -> None:
    """Multiply the erodibility by noise, so that rivers are not alike. variety: standard deviation of its logarithm."""
    grid = grid_of(*bed.shape, bed.step_x, bed.step_y)
    # Noise of ROCK_OCTAVES octaves, the longest with waves of ROCK metres, at the same positions on every level.
    position = [wp.vec2i(*bed.first), wp.vec2d(bed.step_x, bed.step_y), ROCK, ROCK_OCTAVES]
    # The kernel multiplies by about exp(2 * strength * noise), so its strength is half the variety.
    inputs = [grid, *position, 0.5 * variety, wp.uint32(bed.seed & 0xFFFFFFFF), flat(bed.erodibility, wp.float32)]
    rows, columns = bed.shape
    launch.spread(kernels.vary_rock, rows, inputs, step="rivers", threads=bed.threads, cost=6 * columns)


def _noise_of_step(bed: Bed, number: int) -> ReceiverNoise:
    """Return the noise of the receivers in step `number`, the same for a sample in every tile."""
    noise = ReceiverNoise()  # the odd factors below spread seeds and steps over all 32 bits
    noise.jitter, noise.seed = JITTER, (bed.seed * 0x9E3779B1 + number * 0x85EBCA77 + 1) & 0xFFFFFFFF
    noise.row, noise.column = bed.first
    return noise


def _incise(
    bed: Bed, drainage: Drainage, years: float, values: Mapping[str, float]
) -> tuple[kernels.River, np.ndarray | None]:
    """Lower the bed's heights by stream-power incision over `years`; return the kernels' state and the water surface.

    The state is an input of `_deposit`. The water surface, float32 [n] in metres, is computed only with deposition,
    otherwise it is None. values: the operator's parameters by name.
    """
    r, (rows, columns) = kernels.River(), bed.shape  # r: parameters and arrays for the kernels
    rate = np.empty_like(bed.heights)  # samples that erosion travels upstream in the step
    filled = np.empty_like(rate) if values["deposition"] > 0.0 else None
    r.grid, r.lakes, r.deposition = drainage.grid, int(filled is not None), values["deposition"]
    r.cell, r.hillslope, r.strength = bed.step_x * bed.step_y, values["hillslope"], values["erodibility"] * years
    # Largest height above the receiver, metres, by direction: the steepest slope times the distance.
    r.drop = wp.vec3f(*(np.tan(np.radians(values["steepest"])) / np.array([*drainage.grid.inverse_distance])))
    r.to, r.order = flat(drainage.to, wp.uint8), flat(drainage.order, wp.int32)
    r.area = flat(drainage.catchments, wp.float64)  # in samples
    r.erodibility, r.weight = flat(bed.erodibility, wp.float32), flat(bed.weight, wp.float32)
    r.rate, r.h = flat(rate, wp.float32), flat(bed.heights, wp.float32)
    r.filled = r.rate if filled is None else flat(filled, wp.float32)  # not written without `lakes`
    launch.spread(kernels.find_rates, rows, [r], step="rivers", threads=bed.threads, cost=columns / 8)
    launch.once(kernels.cut_down, [r], step="rivers")  # writes `h` and `filled`
    return r, filled


def diffuse(
    bed: Bed,
    values: np.ndarray,
    spread: float,
    still: np.ndarray,
    weight: np.ndarray,
    preserved: np.ndarray | None = None,
) -> np.ndarray:
    """Return `values`, float32 [n], diffused by stable explicit steps or an implicit one; overwrites them.

    The result may be another array than `values`. spread: diffusivity times time, m2. still: uint8 [n], 1 where they do
    not change; the caller includes the border. weight: float32 [n], factor on the change. preserved: float32 [n], part
    of the change in metres that explicit steps leave out; None for none.
    """
    ew, ns = spread / bed.step_x**2, spread / bed.step_y**2  # diffusion numbers along both axes
    rounds = int(np.ceil((ew + ns) / CREEP))  # explicit steps, of a diffusion number of at most CREEP to be stable
    (rows, columns), other = bed.shape, values.copy()
    soil, run = creep_kernels.Soil(), partial(launch.spread, step="rivers", threads=bed.threads)
    soil.grid = grid_of(rows, columns, bed.step_x, bed.step_y)
    soil.base, soil.weight = flat(still, wp.uint8), flat(weight, wp.float32)
    if rounds > MAX_ROUNDS:  # one implicit step, along columns and then along rows
        soil.ew, soil.ns = ew, ns
        soil.scratch, soil.change, soil.h = (flat(a, wp.float32) for a in (other, np.empty_like(values), values))
        blocks = -(-columns // BLOCK)
        run(creep_kernels.creep_along_columns, blocks, [BLOCK, soil], cost=BLOCK * rows / 8)
        run(creep_kernels.creep_along_rows, rows, [soil], cost=columns)
        return values
    soil.ew, soil.ns = ew / max(rounds, 1), ns / max(rounds, 1)
    preserved = np.zeros_like(values) if preserved is None else preserved / np.float32(max(rounds, 1))
    soil.preserved = flat(preserved, wp.float32)
    for _ in range(rounds):  # explicit steps from one array to the other
        soil.old, soil.h = flat(values, wp.float32), flat(other, wp.float32)
        run(creep_kernels.creep, rows - 2, [soil], cost=columns / 16)
        values, other = other, values
    return values


def _deposit(
    bed: Bed, drainage: Drainage, river: kernels.River, raised: np.ndarray, filled: np.ndarray, years: float
) -> np.ndarray:
    """Deposit sediment along the rivers and in lakes, which raises the bed; return each sample's load, float64 [n].

    A load is metres of sediment times samples. river: the kernels' arrays, from `_incise`. raised: heights after
    uplift, before the incision. filled: water's surface. Both are float32 [n] m. years: length of the step.
    """
    load = np.zeros(len(filled)) if bed.inflow is None else bed.inflow * years
    # Before sediment raises the bed. A weight above 0: the mask lets rivers change the sample.
    lake = (filled > bed.heights) & (drainage.base == 0) & (bed.weight > 0.0)
    river.raised, river.load = flat(raised, wp.float32), flat(load, wp.float64)
    launch.once(kernels.deposit, [river], step="rivers")  # changes the bed's heights and adds to `load`
    _level_lake_beds(bed, lake, raised)
    return load


def _level_lake_beds(bed: Bed, lake: np.ndarray, raised: np.ndarray) -> None:
    """Spread the sediment in lakes towards level beds.

    Samples 4, then 2, then 1 apart (APART) exchange sediment along rows and columns, in SETTLING pairs of passes each.
    This moves the bed's heights; `step` updates its sediment. lake: bool [n], no sample of the border. raised: heights
    after uplift, before the incision, float32 [n] m.
    """
    wet = np.flatnonzero(lake)
    before = np.maximum(bed.sediment[wet] + (bed.heights[wet] - raised[wet]), np.float32(0.0))  # metres of sediment
    rock, sediment, scratch = (np.zeros(len(lake), np.float32) for _ in range(3))
    rock[wet], sediment[wet], scratch[wet] = bed.heights[wet] - before, before, before
    arrays = [flat(a, wp.float32) for a in (rock, sediment, scratch)]
    for apart in APART:
        # Lake samples with only lake between them and their partners.
        open_water = _away_from_shore(lake.reshape(bed.shape), apart - 1).reshape(-1)
        segments = (flat(ends, wp.int32) for ends in _segments(open_water))
        inputs = [SETTLING, bed.shape[1], apart, *segments, flat(open_water.view(np.uint8), wp.uint8), *arrays]
        launch.once(kernels.settle, inputs, step="rivers")
    bed.heights[wet] += sediment[wet] - before


def _segments(lake: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first and the last sample of each segment, int32, which start and end in a lake and cover all lakes.

    Segments have more than GAP dry samples between them. lake: bool [n].
    """
    samples = np.flatnonzero(lake).astype(np.int32)
    last = np.diff(samples, append=np.int32(2**31 - 1)) > GAP + 1  # appended so that the very last one ends a segment
    first = np.roll(last, 1)  # the sample after a last one, and the very first
    return samples[first], samples[last]


def _away_from_shore(lake: np.ndarray, distance: int) -> np.ndarray:
    """Return the lake samples that are surrounded by lake within a distance in samples, bool [rows, columns]."""
    inside = lake
    for axis in (0, 1) if distance else ():  # no lake touches the border, so that nothing wraps around
        inside = np.logical_and.reduce([np.roll(inside, by, axis) for by in range(-distance, distance + 1)])
    return inside
