# SPDX-License-Identifier: GPL-3.0-or-later
"""Thermal erosion: cliffs break above the angle of their bed, and scree comes to rest below at its own angle.

A mask scales the rock that may break; scree slides where the mask is 0, too. `ground` is the operator's input, a level
or a tile of it: heights in metres, `missing` (holes), `mask`, layers, and `first`, row and column of its first sample
in the whole level. `launch.spread` runs a kernel for a number of items, each of which takes `cost` times 15 ns.
"""

import math
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..attributes.attribute import Parameter
from ..run import launch
from ..run.buffers import flat
from .balance import balance_mass
from .height_operator import Change, Evaluate, HeightOperator, LandLayer, OperatorGround

if TYPE_CHECKING:
    from ...kernels.land import thermal as kernels

# Sweeps of a level in which rock breaks, then sweeps in which scree comes to rest, and their factor at the coarsest
# level.
BREAKING, RESTING, AT_FIRST = 10, 20, 20
# The angle of repose varies in waves of at most this many metres, so that fans are no planes.
LONGEST, OCTAVES = 500.0, 3
# The upper sample of a pair gives the lower one SHARE of their excess, which leaves none, but at most MAX_FRACTION of
# its scree: on steep rock all of it would oscillate between neighbours. WEATHER: fraction of the excess of bare rock
# that breaks.
SHARE, MAX_FRACTION, WEATHER = 0.5, 0.25, 0.05
# Samples of halo for each sweep. With 1 the island's tiles have the bytes of the whole, though one sweep can carry
# material over 6 samples.
HALO = 1.6


def apply(ground: OperatorGround, values: Mapping[str, float], coarser: Change | None) -> Change:
    """Return how rock breaks off slopes and settles as scree at a level: change of heights, scree and wear.

    values: the parameters by name. coarser: the change of the next coarser level, interpolated to this one.
    """
    shape = ground.heights.shape
    breakable, loose = _breakable_depth(ground, values), ground.layers.get("scree", np.zeros(shape, np.float32))
    left, scree = _start_level(ground, coarser, breakable, loose)
    base = np.ascontiguousarray(ground.heights - loose - breakable)
    if ground.missing is not None:
        base[ground.missing] = np.nan  # holes are walls
    times = AT_FIRST if coarser is None else 1  # factor on the number of sweeps
    scree = settle_scree(base, breakable, left, scree, ground, values, times)
    wear, deposited = breakable - left, scree - loose
    return Change(deposited - wear, {"scree": deposited, "wear": wear})


def _breakable_depth(ground: OperatorGround, values: Mapping[str, float]) -> np.ndarray:
    """Return the depth of rock that may break off each sample, float32 [rows, columns] m; 0 in holes.

    values: the operator's parameters by name.
    """
    breakable = np.full(ground.heights.shape, values["depth"], np.float32)
    if ground.mask is not None:
        breakable *= ground.mask
    if ground.missing is not None:
        breakable[ground.missing] = 0.0
    return breakable


def _start_level(
    ground: OperatorGround, coarse: Change | None, breakable: np.ndarray, loose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rock that may still break and the scree at the start of a level, float32 [rows, columns] m.

    They are `breakable` and `loose`, rock and scree before the operator, after the coarser level's change `coarse`,
    interpolated to this level (None at the coarsest level). Interpolation loses mass at borders and where less rock is
    breakable here; deposits are scaled to conserve it.
    """
    if coarse is None:
        return breakable.copy(), loose.copy()
    coarse_change = coarse.layers["scree"] - coarse.layers["wear"]
    wear, deposited = np.clip(coarse.layers["wear"], 0.0, breakable), coarse.layers["scree"]
    if ground.missing is not None:
        deposited = np.where(ground.missing, np.float32(0.0), deposited)
    scree = np.maximum(loose + deposited, 0.0)
    gain = np.clip(deposited, 0.0, scree)  # without negative deposits, as of scree that slid off
    deposited, wear = balance_mass(
        gain, wear, max_eroded=breakable, change=scree - loose - wear, net=coarse_change, ground=ground
    )
    scree += deposited - gain
    return np.ascontiguousarray(breakable - wear), np.ascontiguousarray(np.maximum(scree, 0.0))


def settle_scree(
    base: np.ndarray,
    breakable: np.ndarray,
    left: np.ndarray,
    scree: np.ndarray,
    ground: OperatorGround,
    values: Mapping[str, float],
    times: int,
) -> np.ndarray:
    """Return the scree after `times` * (BREAKING + RESTING) sweeps, and update `left`, the rest of `breakable` rock.

    The scree is the mean after the last four halves of sweeps. All arrays are float32 [rows, columns] m. Overwrites
    `base` (heights of rock that cannot break) and `scree`. values: the operator's parameters by name.
    """
    from ...kernels.land import thermal as kernels

    slope, mean_scree = pack_slope(ground, values, base, left, scree), np.zeros_like(scree)
    # Noise with waves of up to LONGEST metres is added to `base`, so that the angle at which scree rests varies.
    inputs, cost = [slope, LONGEST, OCTAVES, values["uneven"] * slope.repose], 3.0 * slope.width
    launch.spread(kernels.vary_repose, slope.height, inputs, step="scree", threads=ground.threads, cost=cost)
    breaking, sweeps = times * BREAKING, times * (BREAKING + RESTING)
    recorded: dict = {}  # launches, which `sweep` repeats
    for number in range(sweeps):
        if number == breaking:
            smooth_wear(left, breakable)  # breaking leaves a pattern that alternates from sample to sample
            slope.weather = 0.0  # no more rock breaks
        for _half in sweep(slope, number, ground.threads, recorded):
            # Moving scree is in rows of one parity after each half; the mean of four halves hides that comb.
            if number >= sweeps - 2:
                mean_scree += np.float32(0.25) * scree
        ground.progress((number + 1) / sweeps)
    return mean_scree


def sweep(slope: "kernels.Slope", number: int, threads: int, recorded: dict | None = None) -> Iterator[None]:
    """Run sweep `number`, from 0, and yield after each half. recorded: cache of launch.py for sweeps over one slope.

    The order of slabs alternates, else those of one parity would erode more than the others. The first half also
    settles pairs along the rows, first those whose western column has the parity of `number`.
    """
    from ...kernels.land import thermal as kernels

    spread, odd = partial(launch.spread, step="scree", threads=threads, recorded=recorded), number & 1
    spread(kernels.face_rows, slope.height, [slope], cost=0.1 * slope.width)  # sets slope.facing
    for along, parity in ((1, odd), (0, 1 - odd)):  # along: 1 if pairs along the rows settle, too
        first = -((parity ^ slope.first_row) & 1)  # row of the first slab: -1 if only its second row is in the raster
        slabs, inputs = (slope.height - first + 1) // 2, [first, along, odd, slope]
        spread(kernels.settle_slabs, slabs, inputs, cost=0.5 * slope.width)
        yield


def smooth_wear(left: np.ndarray, breakable: np.ndarray) -> None:
    """Smooth the wear, `breakable` - `left`, by [1 2 1] / 4 along both axes; changes `left` and conserves the wear.

    It removes the part that alternates from sample to sample. left, breakable: float32 [rows, columns], metres of rock
    that is left, and that was there before.
    """
    for a, b, before_a, before_b in (  # neighbours along an axis, and the rock that was there before
        (left[:-1], left[1:], breakable[:-1], breakable[1:]),
        (left[:, :-1], left[:, 1:], breakable[:, :-1], breakable[:, 1:]),
    ):
        # Rock moves from b to a, which has lost more; the limits keep both from running out of it.
        flux = np.float32(0.25) * np.clip((before_a - a) - (before_b - b), -a, b)
        old = a.copy()
        a += flux
        b -= a - old  # the rounded flux


def pack_slope(
    ground: OperatorGround, values: Mapping[str, float], base: np.ndarray, left: np.ndarray, scree: np.ndarray
) -> "kernels.Slope":
    """Return parameters and arrays as the kernels read them; the memory of the arrays is shared.

    Angles become tangents: of scree at rest, of soft and hard rock before it breaks, and of the beds' dip. `thick`: of
    a bed; `dip_x`, `dip_y`: metres that beds fall to the next sample. The upper sample of a pair gives the lower one
    `share` of its excess height, at most `max_fraction` of its scree; `weather` of the bare rock's excess breaks. base:
    heights of the rock that cannot break, left: rock on it that may, scree; float32 [rows, columns] metres. values: the
    operator's parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land import thermal as kernels

    slope = kernels.Slope()
    slope.height, slope.width = ground.heights.shape
    slope.first_row, slope.first_column = ground.first
    slope.step_x, slope.step_y = ground.step_x, ground.step_y
    repose, soft, hard, dip = (
        math.tan(math.radians(values[name])) for name in ("scree_angle", "soft_angle", "hard_angle", "dip")
    )
    slope.repose, slope.soft, slope.hard, slope.thick = repose, soft, hard, values["bed"]
    towards = math.radians(values["dip_to"])
    slope.dip_x, slope.dip_y = dip * math.sin(towards) * ground.step_x, dip * math.cos(towards) * ground.step_y
    slope.max_fraction, slope.share, slope.weather = MAX_FRACTION, SHARE, WEATHER
    slope.seed = ground.seed & 0xFFFFFFFF
    slope.base, slope.left, slope.scree = (flat(array, wp.float32) for array in (base, left, scree))
    slope.facing = flat(np.empty_like(scree), wp.float32)  # `sweep` fills it
    return slope


def example(evaluate: Evaluate) -> None:
    """Assert that a cliff of 100 m in a bed of 60 degrees breaks and conserves mass, and no slope of 30 does.

    evaluate(name, heights, step, **parameters): applies an operator to heights `step` metres apart over all levels.
    """
    x = np.tile(np.arange(65, dtype=np.float32), (33, 1))
    one_bed = {"soft_angle": 60.0, "hard_angle": 60.0, "depth": 20.0}
    change = evaluate("scree", np.where(x < 32, np.float32(100.0), np.float32(0.0)), step=10.0, **one_bed)
    wear, scree = (change.layers[name].astype(np.float64).sum() for name in ("wear", "scree"))
    assert wear > 33 * 10.0 and abs(scree - wear) < 1e-6 * wear
    assert change.heights[:, 31].max() < -10.0 and change.heights[:, 33].min() > 3.0
    change = evaluate("scree", np.float32(10.0 * math.tan(math.radians(30.0))) * x, step=10.0, uneven=0.0)
    assert not change.heights.any()


THERMAL = HeightOperator(
    name="scree",
    label="Scree",
    about="Steep rock breaks off, and loose stones gather below at the angle at which they rest",
    apply=apply,
    kernels=("land.thermal",),
    example=example,
    parameters=(
        Parameter("depth", 30.0, 0.0, 500.0, "m", "Largest thickness of rock that breaks off"),
        Parameter("scree_angle", 34.0, 20.0, 45.0, "degrees", "Angle at which loose stones come to rest"),
        Parameter("uneven", 0.07, 0.0, 1.0, "", "How much that angle varies from place to place, as a fraction of it"),
        Parameter("soft_angle", 38.0, 20.0, 85.0, "degrees", "Slope at which the softest rock layer breaks"),
        Parameter("hard_angle", 70.0, 20.0, 85.0, "degrees", "Slope at which the hardest rock layer breaks"),
        Parameter("bed", 60.0, 1.0, 1000.0, "m", "Thickness of a rock layer"),
        Parameter("dip", 2.5, 0.0, 45.0, "degrees", "Tilt of the rock layers"),
        Parameter("dip_to", 60.0, 0.0, 360.0, "degrees", "Direction in which they fall, clockwise from north"),
    ),
    layers=(
        LandLayer("scree", "m", "Scree on the rock"),
        LandLayer("wear", "m", "Rock that was removed"),
    ),
    reads=("scree",),
    halo=lambda _values, step: HALO * (BREAKING + RESTING) * step,
    masks=True,
    limit="None: a pair of neighbours settles at most fully",
    conserves="Rock and scree together, to 1e-7 of what moved",
    converges="257, 513 and 1,025 samples of the island, twice as steep: 0.94, then 0.48 m rms of 12 m; rests at 34°",
    cost_ns=350,
    source="Musgrave, Kolb and Mace 1989, section 3; here by pairs, one after the other",
    version=4,
)
