# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivers: a terrain ages, or a range grows from uplift, over years. A step is in fluvial.py."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..effects.effect import Parameter
from .cliffs import beside_cliffs
from .fluvial import Bed, bends_of, diffuse, step, vary_rock
from .lake_outlets import keep_outlets
from .land_effect import Change, Evaluate, Ground, LandEffect, LandLayer
from .levels import COARSEST, apply_by_levels
from .river_rims import LAKE, LOAD, edges, sides, take_over

# The coarsest level takes all years, in steps of so many or shorter ones.
STEP_YEARS, LEAST_STEPS, MOST_STEPS = 20e3, 10, 60
# A finer level starts from the coarser change less its part for the last years, which it takes again, in so many steps:
# half of all, and no more than a valley needs to find its shape, which is so much over the erodibility: for land that
# ages (what is worn longer is flat, and every tile finds another way over it) and for land that rises. Each level takes
# half the years of the one before, in which erosion runs up as many samples.
AGAIN, STEPS_AGAIN = 0.5, (20, 12, 8, 6, 5)
SHAPES_AGED, SHAPES_GROWN = 1.0, 2.0
# Straight lines of eight directions come from the coarsest levels: a valley that is cut once never moves. So the first
# half of its steps has one draw of the receivers' noise, along which valleys wind from the start, where with a new one
# in each step the straight way wins; and a finer level gets the coarser change spread over so many of its own squared
# samples, so that valleys find their beds between the coarser samples anew.
SPREAD = 1.5
# Samples of halo around a tile: over all tiles of a level they are off by less than 5 % of what it moved, also on young
# land full of pits (river_rims.py).
HALO = 176
# What comes into a tile is known from the coarser level. So its big rivers, of catchments of more than BIG samples (as
# wide as the halo at the next finer level), have to run where its own do: at most REACH samples beside them, and
# at most ALIKE times as large or as small. Where more than a part ELSEWHERE of all water does not, tiles are off: on
# plains, whose rivers lie anew at each level.
BIG, REACH, ALIKE, ELSEWHERE = (HALO // 2) ** 2, 4, 1.3, 0.25
# Where no map of uplift is given it fades towards the rim, which stays, over this part of the shorter side: else the
# land would end in a cliff.
FADE = 0.15


def apply(ground: Ground, values: Mapping[str, float], coarser: Change | None) -> Change:
    """See Apply in land_effect.py."""
    years, steps = values["years"], min(max(math.ceil(values["years"] / STEP_YEARS), LEAST_STEPS), MOST_STEPS)
    if coarser is not None:
        years, steps = _years_again(ground, values), STEPS_AGAIN[min(_halvings(ground), len(STEPS_AGAIN)) - 1]
    bed, origin = _begin(ground, values, coarser)
    move_edges = edges(bed, origin, coarser, years)
    kept, load = 0 if coarser is not None else steps // 2, np.zeros(len(origin))
    for number in range(steps if years > 0.0 else 0):
        ground.progress(number / steps)
        came = step(bed, years / steps, values, max(number, kept))
        if came is not None and number >= steps // 2:  # those that the finer level takes again
            load += came
        move_edges()
    return _change(bed, ground, values, origin, load / max(years * (1.0 - steps // 2 / steps), 1e-9))


def _change(bed: Bed, ground: Ground, values: Mapping[str, float], origin: np.ndarray, load: np.ndarray) -> Change:
    """load: float64 [n], metres of sediment times samples that came to each in a year."""
    drainage, cell = bed.drain(), ground.step_x * ground.step_y
    change = bed.heights - origin
    wear = bed.lift * np.float32(values["years"]) - change + bed.sediment
    for side in sides(bed.shape):  # no rock is lifted there
        wear.reshape(bed.shape)[side] = (bed.sediment - change).reshape(bed.shape)[side]
    wear[bed.fixed] = 0.0
    layers = {"sediment": bed.sediment, "wear": np.maximum(wear, 0.0), "flow": drainage.catchments * cell}
    kept = {}
    if ground.level:
        kept = {LAKE: drainage.filled() - drainage.heights, LOAD: load * cell}
    shaped = ({k: a.reshape(bed.shape).astype(np.float32) for k, a in some.items()} for some in (layers, kept))
    return Change(change.reshape(bed.shape), *shaped)


def doubts(coarser: Change, own: Change, cell: float) -> bool:
    """See LandEffect."""
    coarse, fine = (change.layers["flow"] / np.float32(cell) for change in (coarser, own))
    return max(_elsewhere(coarse, fine), _elsewhere(fine, coarse)) > ELSEWHERE


def _elsewhere(flow: np.ndarray, other: np.ndarray) -> float:
    """The part of all water that is in big rivers which the other level does not have. Both: float32 [rows, columns],
    samples that drain through each."""
    j, i = np.nonzero(flow > BIG)
    water, near, most = flow[j, i], np.pad(other, REACH), np.zeros(len(j), np.float32)
    for north, east in np.ndindex(2 * REACH + 1, 2 * REACH + 1):
        np.maximum(most, near[j + north, i + east], out=most)
    lost = water[most * np.float32(ALIKE) <= water].sum(dtype=np.float64)
    return float(lost / max(flow.sum(dtype=np.float64), 1.0))


def _years_again(ground: Ground, values: Mapping[str, float]) -> float:
    shaping = SHAPES_GROWN if values["rise"] > 0.0 else SHAPES_AGED
    most = shaping / max(values["erodibility"], 1e-12)
    return min(AGAIN * values["years"], most) * 0.5 ** (_halvings(ground) - 1)


def _halvings(ground: Ground) -> int:
    """How many times finer than the coarsest one this level is."""
    side, count = max(ground.whole), 0
    while side > COARSEST:
        side, count = (side + 1) // 2, count + 1
    return count


def _begin(ground: Ground, values: Mapping[str, float], coarser: Change | None) -> tuple[Bed, np.ndarray]:
    """The bed to start from, and the heights before the effect, with the sea at its surface; float32 [n]."""
    sea, shape, n = np.float32(values["sea"]), ground.heights.shape, ground.heights.size
    missing = np.zeros(n, bool) if ground.missing is None else ground.missing.reshape(-1)
    before = ground.heights.reshape(-1)
    fixed = (before <= sea) | missing
    origin = np.where(missing, before, np.maximum(before, sea))
    part = np.ones(n, np.float32) if ground.mask is None else ground.mask.reshape(-1).astype(np.float32)
    lift = np.where(fixed, np.float32(0.0), np.float32(values["rise"]) * part)
    lift *= (ground.layers["uplift"] if "uplift" in ground.layers else _faded(ground)).reshape(-1)
    for side in sides(shape):
        lift.reshape(shape)[side] = 0.0
    steps = ground.step_x, ground.step_y
    none, own = np.zeros(n, np.float32), np.ones(n)
    bed = Bed(shape, *steps, origin.copy(), none, fixed, part, part.copy(), lift, own, ground.first, ground.seed)
    bed.threads, bed.bends = ground.threads, bends_of(bed)
    if coarser is not None:
        less = np.float32(1.0 - _years_again(ground, values) / max(values["years"], 1.0))
        change, sediment = _spread(bed, coarser)
        bed.heights = np.where(fixed, origin, np.maximum(origin + less * change, sea))
        bed.sediment = np.where(fixed, np.float32(0.0), less * sediment)
        _keep_cliffs(bed, ground, values, origin, less * coarser.heights)
        take_over(bed, ground, coarser)
        keep_outlets(bed, ground, coarser)
    if values["variety"] > 0.0:
        vary_rock(bed, values["variety"])
    return bed, origin


def _faded(ground: Ground) -> np.ndarray:
    """float32 [rows, columns]: 0 at the rim of the whole, 1 from FADE on; smooth."""
    spacings = ground.step_y, ground.step_x
    whole = np.maximum(ground.whole, np.add(ground.first, ground.heights.shape))
    sizes = ground.size or tuple((whole - 1) * spacings)
    wide = FADE * min(sizes)

    def share(first: int, count: int, spacing: float, size: float) -> np.ndarray:
        at = np.arange(first, first + count) * spacing
        part = np.clip(np.minimum(at, size - at) / max(wide, spacing), 0.0, 1.0)
        return part * part * (3.0 - 2.0 * part)

    north, east = map(share, ground.first, ground.heights.shape, spacings, sizes)
    return np.float32(north[:, None] * east)


def _spread(bed: Bed, coarser: Change) -> tuple[np.ndarray, np.ndarray]:
    """What the coarser level changed, and its sediment, without what it knows of single samples; float32 [n]."""
    still = (bed.fixed | (bed.part == 0.0)).reshape(bed.shape).astype(np.uint8)
    for side in sides(bed.shape):
        still[side] = 1
    numbers = SPREAD * bed.step_x * bed.step_y, still.reshape(-1), np.ones(len(bed.part), np.float32)
    return tuple(diffuse(bed, a.reshape(-1).copy(), *numbers) for a in (coarser.heights, coarser.layers["sediment"]))


def _keep_cliffs(bed: Bed, ground: Ground, values: Mapping[str, float], origin: np.ndarray, change: np.ndarray) -> None:
    """change: float32 [rows, columns] m, of the coarser level at the time that the bed starts at."""
    before = origin.reshape(bed.shape)
    after = np.maximum(before + change, np.float32(values["sea"]))
    drop = math.tan(math.radians(values["steepest"])) * max(bed.step_x, bed.step_y)
    heights = beside_cliffs(bed.heights.reshape(bed.shape), before, after, ground.first, drop).reshape(-1)
    heights = np.where(bed.fixed | (bed.part == 0.0), bed.heights, heights)
    bed.sediment = bed.sediment + np.maximum(heights - bed.heights, np.float32(0.0))  # has slid into the trench
    bed.heights = heights


def grow(
    start: np.ndarray, uplift: np.ndarray, step_m: float, seed: int = 0, threads: int = 1, **parameters: float
) -> Change:
    """A range grown out of `start`: what rivers leave of an uplift that lasts for `years`.

    start: float32 [rows, columns] m, samples `step_m` apart; what is not above `sea` stays. uplift: float32 of the same
    shape, m / year, of the order of 5e-4. parameters: those of rivers but `rise`; the years are 3 million and the
    erodibility is 1e-5 / year where none are given, which leaves the range about steady.
    """
    most = float(uplift.max())
    values = RIVERS.defaults() | {"years": 3e6, "erodibility": 1e-5, "rise": most} | parameters
    share = (uplift / np.float32(most or 1.0)).astype(np.float32)
    ground = Ground(np.asarray(start, np.float32), step_m, step_m, seed=seed, threads=threads)
    return apply_by_levels(RIVERS, replace(ground, layers={"uplift": share}), values)


def example(evaluate: Evaluate) -> None:
    """A skerry of one sample: of its height F / (1 + F) goes in every step, over one of its sides or corners."""
    heights = np.full((9, 9), -5.0, np.float32)
    heights[4, 4] = 8.0
    values = {"years": 2e5, "erodibility": 4e-6, "hillslope": 2e4, "creep": 0.0, "variety": 0.0}
    made = evaluate("rivers", heights, step=20.0, **values)
    wave = 4e-6 * 20e3 * math.sqrt(2e4 + 400.0) / 20.0
    left, most = 8.0 + made.heights[4, 4], 8.0 / (1.0 + wave * 0.5**0.5) ** 10
    assert 8.0 / (1.0 + wave) ** 10 - 1e-5 < left < most + 1e-5
    assert abs(made.layers["wear"][4, 4] - (8.0 - left)) < 1e-5 and made.layers["flow"][4, 4] == 400.0
    made.heights[4, 4] = 0.0
    assert not made.heights.any()


RIVERS = LandEffect(
    name="rivers",
    label="Rivers",
    about="Streams cut valleys, slopes creep, valley floors and lakes fill; with a rise, a range grows",
    apply=apply,
    example=example,
    parameters=(
        Parameter("years", 300e3, 0.0, 20e6, "years", "How long it lasts"),
        Parameter("erodibility", 4e-6, 0.0, 1e-3, "1/year", "How soft the rock is: K of the stream power law"),
        Parameter("hillslope", 5e3, 0.0, 1e7, "m2", "Area that drains to the foot of a slope without a stream"),
        Parameter("variety", 0.2, 0.0, 1.0, "", "How much the rock's softness varies, over 60 to 960 m"),
        Parameter("rise", 0.0, 0.0, 0.02, "m/year", "Uplift, less towards the rim; rim and sea stay"),
        Parameter("creep", 5e-4, 0.0, 1.0, "m2/year", "Diffusion of slopes, which rounds them"),
        Parameter("deposition", 1.0, 0.0, 20.0, "", "How readily streams lay down what they carry: G"),
        Parameter("steepest", 60.0, 5.0, 89.0, "degrees", "Steepest slope along a stream that does not slide"),
        Parameter("sea", 0.0, -12000.0, 9000.0, "m", "Ground up to this height is sea, and stays"),
    ),
    layers=(
        LandLayer("sediment", "m", "Depth of what rivers have laid down"),
        LandLayer("wear", "m", "Depth of rock that rivers have removed"),
        LandLayer("flow", "m2", "Land that drains through a place, along single paths", per_metre=False),
    ),
    kept=(LAKE, LOAD),
    reads=("uplift",),
    halo=lambda _values, spacing: HALO * spacing,
    doubts=doubts,
    masks=True,
    limit="none: a step may have any length; the network lags behind steps of more than 20,000 years; ground above "
    "`steepest` becomes walls of that slope",
    converges="on the island's land, levels at 8, 4 and 2 m add 2.5, 1.3, 0.8 m rms aged by 180,000 years, and 11, "
    "4.7, 2.3 m grown by 2 million; only for twice as many cells: with 1,030 samples instead of 1,025 valleys lie "
    "elsewhere, 8.6 m rms of a change of 60 m, and 91 of 289 m grown",
    cost_ns=650,
    conserves="within one level, what is cut is deposited or leaves over the open border or into the sea, where it is "
    "lost; on 257 x 257 samples of the mountains that was 91 % of what moved",
    source="Braun and Willett 2013, section 3; deposition, Davy and Lague 2009; depressions, Cordonnier et al. 2019",
    version=10,
)
