# SPDX-License-Identifier: GPL-3.0-or-later
"""Rivers: a terrain that ages, or a range that grows from uplift. fluvial.py has the equation and its step.

`ground` is the operator's input, a level or a tile of it: heights in metres, `missing` (holes), `mask`, layers, and
`first`, row and column of its first sample in the whole level. A `Bed` is the state of a level while it is aged: arrays
of n samples in C order, as heights, sediment and uplift.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..attributes.attribute import Parameter
from .cliffs import limit_at_cliffs
from .height_operator import Change, Evaluate, HeightOperator, LandLayer, OperatorGround
from .levels import COARSEST
from .river_borders import LAKE, LOAD, border_motion, set_boundary, sides

if TYPE_CHECKING:
    from .fluvial import Bed

# The coarsest level simulates all years, in steps of at most STEP_YEARS if their number is in this range.
STEP_YEARS, MIN_STEPS, MAX_STEPS = 20e3, 10, 60
# A finer level starts from the coarser change at an earlier time and simulates the last years again, in these numbers
# of steps: half of all years, and at most the time in which a valley finds its shape. That is a number over the
# erodibility, one for land that ages (which longer erosion flattens, so that every tile finds other rivers on it) and
# one for land that rises. Each level simulates half the years of the coarser one, so that erosion travels as many
# samples.
AGAIN, STEPS_AGAIN = 0.5, (20, 12, 8, 6, 5)
SHAPES_AGED, SHAPES_GROWN = 1.0, 2.0
# Straight lines in eight directions come from the coarsest level, since a valley that is cut never moves. Therefore all
# steps of its first half have the same noise of receivers, along which valleys wind from the start; with new noise in
# each step the straight path would win. A finer level starts from the coarser change diffused over this many of its
# squared samples, so that valleys find their beds between the coarser samples.
SPREAD = 1.5
# Samples of halo around a tile. All tiles of a level differ from the level in one piece by less than 5 % of its change,
# on young land full of pits too (river_borders.py).
HALO = 176
# The coarser level gives the inflow of a tile. So big rivers of both levels, with drainage areas of more than BIG
# samples (as wide as the halo at the next finer level), have to agree: within REACH samples, and within a factor ALIKE
# of their area. If more than a fraction ELSEWHERE of all water is in others, tiles are wrong, as on plains, whose
# rivers differ at each level.
BIG, REACH, ALIKE, ELSEWHERE = (HALO // 2) ** 2, 4, 1.3, 0.25
# Without a map, uplift fades to 0 at the border over this fraction of the shorter side, which avoids a cliff there.
FADE = 0.15


def apply(ground: OperatorGround, values: Mapping[str, float], coarser: Change | None) -> Change:
    """Return how rivers change the heights of a level, with sediment, wear and drainage area as layers.

    values: the parameters by name. coarser: the change of the next coarser level, interpolated to this one, from which
    this level starts; None at the coarsest level.
    """
    from .fluvial import step

    years, steps = values["years"], min(max(math.ceil(values["years"] / STEP_YEARS), MIN_STEPS), MAX_STEPS)
    if coarser is not None:  # fewer years, and by level fewer steps
        years, steps = _years_again(ground, values), STEPS_AGAIN[min(_spacing_halvings(ground), len(STEPS_AGAIN)) - 1]
    bed, origin = _begin(ground, values, coarser)
    move_border = border_motion(bed, origin, coarser, years)
    first_draw, load = 0 if coarser is not None else steps // 2, np.zeros(len(origin))  # load: sum of `step_load`
    for number in range(steps if years > 0.0 else 0):
        ground.progress(number / steps)
        # At the coarsest level all steps of the first half have the noise of receivers of step `first_draw`: with new
        # noise in each, straight valleys would win. `step_load`: metres times samples, None without deposition.
        step_load = step(bed, years / steps, values, max(number, first_draw))
        if step_load is not None and number >= steps // 2:  # the years that the finer level simulates again
            load += step_load
        move_border()
    years_of_load = years * (1.0 - steps // 2 / steps)  # those of the steps that `load` adds up
    return _change_of_bed(bed, ground, values, origin, load / max(years_of_load, 1e-9))


def _change_of_bed(
    bed: "Bed", ground: OperatorGround, values: Mapping[str, float], origin: np.ndarray, load: np.ndarray
) -> Change:
    """Return the change of the heights since `origin`, with the layers and the state for the next finer level.

    origin: float32 [n], heights before all steps. load: float64 [n], sediment that came to each sample, metres times
    samples a year. values: the operator's parameters by name.
    """
    drainage, cell = bed.drain(), ground.step_x * ground.step_y
    change = bed.heights - origin
    # Lowering of the rock, which is the ground without its sediment, relative to the uplift.
    wear = bed.uplift * np.float32(values["years"]) - change + bed.sediment
    for side in sides(bed.shape):  # bed.uplift is the given motion of the border there (`border_motion`), not of rock
        wear.reshape(bed.shape)[side] = (bed.sediment - change).reshape(bed.shape)[side]
    wear[bed.fixed] = 0.0
    layers = {"sediment": bed.sediment, "wear": np.maximum(wear, 0.0), "flow": drainage.catchments * cell}
    state = {}
    if ground.level:
        state = {LAKE: drainage.filled() - drainage.heights, LOAD: load * cell}
    shaped = ({k: a.reshape(bed.shape).astype(np.float32) for k, a in some.items()} for some in (layers, state))
    return Change(change.reshape(bed.shape), *shaped)


def doubts(coarser: Change, change: Change, cell: float) -> bool:
    """Return whether the big rivers of two levels take different courses, so that finer levels must be whole.

    coarser: change of the coarser level, interpolated. change: that of the finer one. cell: m^2 of a sample.
    """
    coarse, fine = (change.layers["flow"] / np.float32(cell) for change in (coarser, change))
    return max(_elsewhere(coarse, fine), _elsewhere(fine, coarse)) > ELSEWHERE


def _elsewhere(flow: np.ndarray, other: np.ndarray) -> float:
    """Return the fraction of all water that is in big rivers which the other level lacks.

    A river is big at samples with a drainage area above BIG. The other level lacks it if no drainage area within REACH
    samples reaches 1 / ALIKE of it. flow, other: drainage areas at both levels, float32 [rows, columns] in samples.
    """
    j, i = np.nonzero(flow > BIG)
    water, padded, max_nearby = flow[j, i], np.pad(other, REACH), np.zeros(len(j), np.float32)
    for north, east in np.ndindex(2 * REACH + 1, 2 * REACH + 1):
        np.maximum(max_nearby, padded[j + north, i + east], out=max_nearby)
    lost = water[max_nearby * np.float32(ALIKE) <= water].sum(dtype=np.float64)
    return float(lost / max(flow.sum(dtype=np.float64), 1.0))


def _years_again(ground: OperatorGround, values: Mapping[str, float]) -> float:
    """Return the years for which a finer level is aged again, after its start from the coarser change.

    At the first level below the coarsest it is a fraction AGAIN of all years, at most the time in which rivers shape
    the land. It halves with each further level.
    """
    shaping = SHAPES_GROWN if values["rise"] > 0.0 else SHAPES_AGED
    longest = shaping / max(values["erodibility"], 1e-12)
    return min(AGAIN * values["years"], longest) * 0.5 ** (_spacing_halvings(ground) - 1)


def _spacing_halvings(ground: OperatorGround) -> int:
    """Return the number of halvings of the spacing from the coarsest level to this one."""
    side, count = max(ground.whole), 0
    while side > COARSEST:
        side, count = (side + 1) // 2, count + 1
    return count


def _begin(ground: OperatorGround, values: Mapping[str, float], coarser: Change | None) -> "tuple[Bed, np.ndarray]":
    """Return the initial bed, and the heights before the operator with the sea at its surface, float32 [n].

    values: the operator's parameters by name. coarser: the change of the next coarser level, interpolated; None at the
    coarsest.
    """
    from .fluvial import Bed, curvature_of, vary_rock
    from .lake_outlets import keep_outlets

    sea, shape, n = np.float32(values["sea"]), ground.heights.shape, ground.heights.size
    missing = np.zeros(n, bool) if ground.missing is None else ground.missing.reshape(-1)
    before = ground.heights.reshape(-1)
    fixed = (before <= sea) | missing  # the sea and holes do not change
    origin = np.where(missing, before, np.maximum(before, sea))  # from which the change is counted
    mask = np.ones(n, np.float32) if ground.mask is None else ground.mask.reshape(-1).astype(np.float32)
    uplift = np.where(fixed, np.float32(0.0), np.float32(values["rise"]) * mask)
    # The layer is a factor on `rise`.
    uplift *= (ground.layers["uplift"] if "uplift" in ground.layers else _fade(ground)).reshape(-1)
    for side in sides(shape):  # `border_motion` moves the border
        uplift.reshape(shape)[side] = 0.0
    bed = Bed(
        (shape[0], shape[1]),
        ground.step_x,
        ground.step_y,
        heights=origin.copy(),
        sediment=np.zeros(n, np.float32),
        fixed=fixed,
        weight=mask,
        erodibility=mask.copy(),  # factor on the rate of erosion; `vary_rock` multiplies it by noise
        uplift=uplift,
        cell_weight=np.ones(n),  # `set_boundary` adds water from outside
        first=ground.first,
        seed=ground.seed,
        threads=ground.threads,
    )
    bed.curvature = curvature_of(bed)  # of the ground before all steps, which creep preserves
    if coarser is not None:
        # Start from a part of the coarser change, diffused so that valleys can find beds between the coarser samples.
        # done: the part that is there when the years begin that this level simulates again.
        done = np.float32(1.0 - _years_again(ground, values) / max(values["years"], 1.0))
        change, sediment = _diffused_change(bed, coarser)
        bed.heights = np.where(fixed, origin, np.maximum(origin + done * change, sea))
        bed.sediment = np.where(fixed, np.float32(0.0), done * sediment)
        # The diffused change dug trenches at cliffs; this fills them.
        _restore_cliffs(bed, ground, values, origin, done * coarser.heights)
        set_boundary(bed, ground, coarser)
        keep_outlets(bed, ground, coarser)
    if values["variety"] > 0.0:
        vary_rock(bed, values["variety"])
    return bed, origin


def _fade(ground: OperatorGround) -> np.ndarray:
    """Return a smooth factor from 0 at the raster's border to 1 inside, float32 [rows, columns].

    It rises over FADE times the raster's shorter side.
    """
    spacings = ground.step_y, ground.step_x
    sizes = ground.size or [(n - 1) * step for n, step in zip(ground.whole_shape, spacings, strict=True)]
    fade_width = FADE * min(sizes)

    def fade_along(first: int, count: int, spacing: float, size: float) -> np.ndarray:
        """Return weights along one axis: 1 inside, smoothly to 0 at both borders of the raster, float64 [count].

        first: number of the first sample in the raster. spacing: metres between samples. size: the raster's, metres.
        """
        metres = np.arange(first, first + count) * spacing
        t = np.clip(np.minimum(metres, size - metres) / max(fade_width, spacing), 0.0, 1.0)
        return t * t * (3.0 - 2.0 * t)

    north, east = map(fade_along, ground.first, ground.heights.shape, spacings, sizes)
    return (north[:, None] * east).astype(np.float32)


def _diffused_change(bed: "Bed", coarser: Change) -> tuple[np.ndarray, np.ndarray]:
    """Return the coarser level's change and sediment, diffused over SPREAD, both float32 [n] m.

    Interpolation would leave edges otherwise.
    """
    from .fluvial import diffuse

    still = (bed.fixed | (bed.weight == 0.0)).reshape(bed.shape).astype(np.uint8)
    for side in sides(bed.shape):
        still[side] = 1
    spread_m2, weight = SPREAD * bed.step_x * bed.step_y, np.ones(len(bed.weight), np.float32)
    arrays = coarser.heights, coarser.layers["sediment"]
    change, sediment = (diffuse(bed, a.reshape(-1).copy(), spread_m2, still.reshape(-1), weight) for a in arrays)
    return change, sediment


def _restore_cliffs(
    bed: "Bed", ground: OperatorGround, values: Mapping[str, float], origin: np.ndarray, change: np.ndarray
) -> None:
    """Undo the smearing of cliffs, once at the start of a level, by changing the bed.

    `_diffused_change` smears the coarser change over cliffs and so digs trenches at them. So each height
    is limited to one sample's steepest drop above and below the coarser level's samples around it, after their change.
    What is raised counts as sediment. change: float32 [rows, columns] m, the coarser level's change before it was
    diffused. origin: heights before any change.
    """
    before = origin.reshape(bed.shape)
    after = np.maximum(before + change, np.float32(values["sea"]))
    drop = math.tan(math.radians(values["steepest"])) * max(bed.step_x, bed.step_y)
    heights = bed.heights.reshape(bed.shape)
    heights = limit_at_cliffs(heights, before, after, first=ground.first, drop=drop).reshape(-1)
    heights = np.where(bed.fixed | (bed.weight == 0.0), bed.heights, heights)
    bed.sediment = bed.sediment + np.maximum(heights - bed.heights, np.float32(0.0))  # fills the trench
    bed.heights = heights


def example(evaluate: Evaluate) -> None:
    """Assert that an islet of one sample loses no less than erosion over a corner takes, and no more than over a side.

    That is F / (1 + F) of its height in every step, F = K dt (A + A0)^(1/2) / dx. Nothing else changes.
    evaluate(name, heights, step, **parameters): applies an operator to heights `step` metres apart over all levels.
    """
    heights = np.full((9, 9), -5.0, np.float32)
    heights[4, 4] = 8.0
    values = {"years": 2e5, "erodibility": 4e-6, "hillslope": 2e4, "creep": 0.0, "variety": 0.0}
    change = evaluate("rivers", heights, step=20.0, **values)
    f_side = 4e-6 * 20e3 * math.sqrt(2e4 + 400.0) / 20.0  # F over a side, in each of 10 steps; 400 m2: the islet
    remaining, highest = 8.0 + change.heights[4, 4], 8.0 / (1.0 + f_side * 0.5**0.5) ** 10
    assert 8.0 / (1.0 + f_side) ** 10 - 1e-5 < remaining < highest + 1e-5
    assert abs(change.layers["wear"][4, 4] - (8.0 - remaining)) < 1e-5 and change.layers["flow"][4, 4] == 400.0
    change.heights[4, 4] = 0.0
    assert not change.heights.any()


RIVERS = HeightOperator(
    name="rivers",
    label="Rivers",
    about="Rivers cut valleys, slopes become round, valley floors and lakes fill up; with Rise, mountains grow",
    apply=apply,
    kernels=("effects.catchment", "effects.routing", "land.creep", "land.fluvial"),
    example=example,
    parameters=(
        Parameter("years", 300e3, 0.0, 20e6, "years", "How long rivers work: longer cuts deeper valleys"),
        Parameter("erodibility", 4e-6, 0.0, 1e-3, "1/year", "How soft the rock is: K of the stream power law"),
        Parameter("hillslope", 5e3, 0.0, 1e7, "m2", "Area above the start of a stream: larger makes fewer valleys"),
        Parameter("variety", 0.2, 0.0, 1.0, "", "How much the softness of the rock varies, over 60 to 960 m"),
        Parameter("rise", 0.0, 0.0, 0.02, "m/year", "How fast the land is lifted into mountains; border and sea stay"),
        Parameter("creep", 5e-4, 0.0, 1.0, "m2/year", "How fast slopes become round"),
        Parameter("deposition", 1.0, 0.0, 20.0, "", "How readily rivers drop their load: higher fills valleys (G)"),
        Parameter("steepest", 60.0, 5.0, 89.0, "degrees", "Steepest slope along a stream; steeper ground slides down"),
        Parameter("sea", 0.0, -12000.0, 9000.0, "m", "Height of the sea: lower ground stays as it is"),
    ),
    layers=(
        LandLayer("sediment", "m", "Depth of the material that rivers have deposited"),
        LandLayer("wear", "m", "Depth of rock that rivers have removed"),
        LandLayer("flow", "m2", "Land that drains through a place, along single paths", adds_up=False),
    ),
    state=(LAKE, LOAD),
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
    conserves="within one level, eroded ground is deposited or leaves over the open border or into the sea, where it "
    "is lost; on 257 x 257 samples of the mountains that was 91 % of what moved",
    source="Braun and Willett 2013, section 3; deposition, Davy and Lague 2009; depressions, Cordonnier et al. 2019",
    version=10,
)
