# SPDX-License-Identifier: GPL-3.0-or-later
"""Droplets: short gullies and small fans from rain that runs a few hundred metres, for use after rivers.

A mask scales erosion; deposition follows from it. Droplets start in tiles of four colours: tiles of one colour, which
do not touch, run in parallel, the colours one after another. `ground` is the operator's input, a level or a tile of it:
heights in metres, `missing` (holes), `mask`, `first`, row and column of its first sample in the whole level, and
`target`, rows and columns whose change is needed. `launch.spread` runs a kernel for a number of items, each of which
takes `cost` times 15 ns.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..attributes.attribute import Parameter
from ..run import launch
from ..run.buffers import flat
from .height_operator import Change, Evaluate, HeightOperator, LandLayer, OperatorGround

if TYPE_CHECKING:
    from ...kernels.land import droplets as kernels

# The positions of gullies differ between levels, only their amount converges. So droplets run on each level down to
# this many metres between samples, independently of the coarser one; finer levels smooth the gullies of that level.
FINEST_STEP = 8.0
# On coarse levels a droplet stands for several, so that at most this many fall on a sample. On levels whose spacing is
# above this fraction of the reach there are no gullies.
MAX_PER_SAMPLE, COARSEST_STEP = 4.0, 0.25
# Length scales in metres: of turning downhill, of reaching the capacity, of drying; diameter of the brush. Capacity of
# a droplet on a slope of 1 in m3.
TURN, LOAD, DRY, BRUSH, CAPACITY = 12.0, 120.0, 600.0, 16.0, 250.0


def apply(ground: OperatorGround, values: Mapping[str, float], coarser: Change | None) -> Change:
    """Return the change of heights that erosion by droplets makes at a level, with sediment and wear as layers.

    Levels with a spacing above COARSEST_STEP times the droplets' reach are too coarse and stay unchanged. coarser: the
    change of the next coarser level, interpolated to this one. Levels finer than FINEST_STEP only smooth it. The others
    do not use it, as gullies are elsewhere on each level. values: the operator's parameters by name.
    """
    if coarser is not None and max(ground.step_x, ground.step_y) < FINEST_STEP:
        change = _smooth(coarser.heights, ground.missing)
    elif min(ground.heights.shape) < 2 or min(ground.step_x, ground.step_y) > COARSEST_STEP * values["reach"]:
        change = np.zeros(ground.heights.shape, np.float32)
    else:
        change, _lost = rain_on(ground, values)
        change = _smooth(change.astype(np.float32), ground.missing)
    return Change(change, {"sediment": np.maximum(change, 0.0), "wear": np.maximum(-change, 0.0)})


def _smooth(change: np.ndarray, missing: np.ndarray | None) -> np.ndarray:
    """Return a change, metres, smoothed by [1 2 1] / 4 along both axes, which conserves its sum.

    missing: bool, samples that do not change; None for none.
    It removes the washboard that droplets leave on level ground and smooths linear stretches between coarse samples.
    """
    out = change.copy()
    still = np.zeros(out.shape, bool) if missing is None else missing
    for a, b, is_blocked in (
        (out[:-1], out[1:], still[:-1] | still[1:]),
        (out[:, :-1], out[:, 1:], still[:, :-1] | still[:, 1:]),
    ):
        exchanged = np.where(is_blocked, np.float32(0.0), np.float32(0.25) * (a - b))
        a -= exchanged
        b += exchanged
    if missing is not None:
        out[missing] = 0.0
    return out


def rain_on(ground: OperatorGround, values: Mapping[str, float]) -> tuple[np.ndarray, float]:
    """Run the droplets that can affect the target; return the change and the m3 that left at the border.

    The change is float64 [rows, columns] m, complete in the target only. values: the operator's parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land import droplets as kernels

    rain = _rain(ground, values)
    heights, change = ground.heights.copy(), np.zeros(ground.heights.shape)
    if ground.missing is not None:
        heights[ground.missing] = np.nan
    mask = np.ones(heights.shape, np.float32) if ground.mask is None else np.ascontiguousarray(ground.mask, np.float32)
    rain.ground, rain.mask, rain.change = flat(heights, wp.float32), flat(mask, wp.float32), flat(change, wp.float64)
    lost = 0.0
    for colour, tiles in enumerate(_tiles(rain, ground)):
        lost_by_tile = np.zeros(len(tiles))
        inputs = [flat(tiles, wp.int32), rain, flat(lost_by_tile, wp.float64)]
        cost = 5.0 * rain.drops * rain.steps
        launch.spread(kernels.rain_on_tiles, len(tiles), inputs, step="droplets", threads=ground.threads, cost=cost)
        lost += math.fsum(lost_by_tile)
        ground.progress((colour + 1) / 4)
    return change, lost


def _rain(ground: OperatorGround, values: Mapping[str, float]) -> "kernels.DropletRain":
    """Return the droplets' parameters for kernels, without arrays; a step is as long as the smaller spacing of samples.

    values: `droplets` is their number per square kilometre. They start in tiles of `rows` x `columns` samples, `drops`
    in each; none reaches half a tile beyond its own. `across`: number of tiles from west to east.
    """
    from ...kernels.land import droplets as kernels

    rain, stride = kernels.DropletRain(), min(ground.step_x, ground.step_y)
    rain.height, rain.width = ground.heights.shape
    rain.first_row, rain.first_column = ground.first
    rain.step_x, rain.step_y, rain.stride = ground.step_x, ground.step_y, stride
    rain.steps = max(1, int(values["reach"] / stride))  # of each droplet, at most
    # Radius of the brush in samples.
    rain.brush_x, rain.brush_y = (max(1, round(0.5 * BRUSH / step)) for step in (ground.step_x, ground.step_y))
    # More than twice as far as a droplet with its last brush can reach, in samples; 3 for that brush, which is wider,
    # and for rounding to samples.
    rain.rows, rain.columns = (
        math.ceil(2.0 * (rain.steps * stride / step + brush + 3.0))
        for step, brush in ((ground.step_y, rain.brush_y), (ground.step_x, rain.brush_x))
    )
    rain.across = -(-ground.whole_shape[1] // rain.columns)
    per_sample = values["droplets"] * 1e-6 * ground.step_x * ground.step_y
    simulated = min(per_sample, MAX_PER_SAMPLE)
    rain.drops = round(simulated * rain.rows * rain.columns)
    # Each simulated droplet carries the load of those that are left out.
    rain.capacity = CAPACITY * values["strength"] * per_sample / max(simulated, 1e-12)
    rain.sea = values["sea"]
    # Fractions that a step leaves of the direction, of the missing load and of the water, from the metres in which each
    # falls to 1/e; float32, since the last bit of exp differs between machines.
    inertia, load_left, water_left = (float(np.float32(math.exp(-stride / length))) for length in (TURN, LOAD, DRY))
    rain.seed = (ground.seed * 0x9E3779B9) & 0xFFFFFFFF  # an odd factor, which spreads seeds over all 32 bits
    rain.inertia, rain.load, rain.dry = inertia, 1.0 - load_left, 1.0 - water_left
    return rain


def _tiles(rain: "kernels.DropletRain", ground: OperatorGround) -> list[np.ndarray]:
    """Return for each colour the tiles that can affect the target window, as numbers in the whole level, int32.

    These are the tiles within reach of the target, and the tiles of earlier colours within reach of them.
    """
    rows_and_columns, within_reach = [], []
    target = ground.target or [slice(0, n) for n in ground.heights.shape]
    for first, count, whole, side, window in zip(
        ground.first, ground.heights.shape, ground.whole_shape, (rain.rows, rain.columns), target, strict=True
    ):
        last = min(first + count, whole) - 1
        # Tile t has the samples t * side to (t + 1) * side - 1 of the level, and its droplets reach half a tile
        # further. `first`, `count`: samples of the window; `window`: its target.
        tiles_along = np.arange(first // side, last // side + 1)
        reach = side // 2
        rows_and_columns.append(tiles_along)
        within_reach.append(
            ((tiles_along + 1) * side > first + window.start - reach)
            & (tiles_along * side < first + window.stop + reach)
        )
    needed = np.logical_and.outer(*within_reach)  # both the row and the column of a tile are within reach
    # A tile reads its neighbours of earlier colours. Colours run in the order 0 to 3: 0 and 1 in even rows of tiles, 3
    # and 2 in odd ones.
    odd_row, odd_column = (n % 2 for n in np.meshgrid(*rows_and_columns, indexing="ij"))
    colours = 2 * odd_row + (odd_row ^ odd_column)
    for colour in (3, 2, 1):
        needed |= _dilate(needed & (colours == colour)) & (colours < colour)
    tiles = np.add.outer(rows_and_columns[0] * rain.across, rows_and_columns[1]).astype(np.int32)
    return [tiles[needed & (colours == colour)] for colour in range(4)]


def _dilate(tiles: np.ndarray) -> np.ndarray:
    """Return the flagged tiles and their eight neighbours. tiles: flags, bool [rows, columns], as the result."""
    wide = np.pad(tiles, 1)
    tall = wide[:-2] | wide[1:-1] | wide[2:]
    return tall[:, :-2] | tall[:, 1:-1] | tall[:, 2:]


def _halo(values: Mapping[str, float], step: float) -> float:
    """Return the halo in metres: 4 sides of a droplet tile, or more; 2 samples on levels that only smooth.

    Droplets that reach the target start within half a side of it, the earlier tiles that affect them are at most two
    tiles further, and these read half a side beyond. step: metres between samples.
    """
    if step < FINEST_STEP:  # no droplets run, gullies of the coarser level are smoothed
        return 2.0 * step
    return 8.0 * (values["reach"] + max(0.5 * BRUSH, step) + 5.0 * step)


def example(evaluate: Evaluate) -> None:
    """Assert that a funnel fills from its flanks and conserves mass, and that a plain does not change.

    evaluate(name, heights, step, **parameters): applies an operator to heights `step` metres apart over all levels.
    """
    x = np.abs(np.arange(65, dtype=np.float32) - 32.0)
    far = np.maximum(x[:, None], x)
    change = evaluate("droplets", 10.0 + 5.0 * far, step=10.0).heights
    assert change[far < 3].mean() > 3.0 and change[(far > 12) & (far < 30)].mean() < -0.5
    assert abs(change.sum(dtype=np.float64)) < 1e-6 * np.abs(change).sum(dtype=np.float64)
    assert not evaluate("droplets", np.full((33, 65), 10.0), step=10.0).heights.any()


DROPLETS = HeightOperator(
    name="droplets",
    label="Gullies",
    about="Short gullies and small fans of earth, cut by drops of rain",
    apply=apply,
    kernels=("land.droplets",),
    example=example,
    parameters=(
        Parameter("droplets", 20000.0, 0.0, 200000.0, "1/km²", "Number of droplets: more cut more gullies"),
        Parameter("reach", 480.0, 50.0, 2000.0, "m", "Longest path of a droplet: longer makes longer gullies"),
        Parameter("strength", 1.0, 0.0, 10.0, "", "How much earth a droplet carries: 1 is 250 m³ on a slope of 45°"),
        Parameter("sea", 0.0, -12000.0, 9000.0, "m", "Height of the sea, where droplets end"),
    ),
    layers=(
        LandLayer("sediment", "m", "What droplets have laid down"),
        LandLayer("wear", "m", "Rock that was removed"),
    ),
    halo=_halo,
    masks=True,
    limit="None: a droplet digs at most to the height of its next place",
    conserves="within one level, eroded ground is deposited or leaves over the open border, where it is lost; "
    "on 257 x 257 samples of the mountains that was 7 % of what moved, 51 % in the eight samples at the border",
    converges="the amount, not the places: 1.2, then 1.1 m rms of 2.4 m at 32, 16 and 8 m; finer levels add nothing; "
    "with 1,030 samples instead of 1,025, 1.3 m rms of 3.4 m",
    cost_ns=2000,
    source="Beyer 2015, in metres and conserving",
    version=2,
)
