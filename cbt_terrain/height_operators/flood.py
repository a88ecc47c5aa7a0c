# SPDX-License-Identifier: GPL-3.0-or-later
"""A flood over time: minutes of rain, or a surge of the sea. Heights do not change.

`launch.spread` runs a kernel for a number of items, each of which takes `cost` times 15 ns.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..attributes.attribute import Parameter
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import flat
from .height_operator import Change, Evaluate, HeightOperator, OperatorGround
from .water import DEPTH, SPEED

GRAVITY = 9.81
# Fraction of the longest stable step, and the smallest depth in metres that it is computed for, as of the first rain.
SAFE, MIN_DEPTH = 0.99, 0.05
# More steps take hours; the cause is ground that is not land or a needlessly deep sea.
MAX_STEPS = 500_000
# Speeds are computed for at least this depth, metres.
MIN_DEPTH_OF_SPEED = 0.01
HOUR = 3600.0


@dataclass(eq=False)
class Flood:
    """Water on a bed at one time; `bed` and `rain` float32, `water` float64, all [rows, columns].

    Attributes:
        bed, water: height and depth in metres; rain: m/s.
        metres: spacing of samples to the east and north.
        rough: Manning's coefficient.
        outlets: int64 [n], indices in C order of border samples and holes; their depth is `deep` metres, [n], after
            each step.
        left: metres, sum of the depths that left there.
        fluxes: float64 [2, rows + 2, columns], m^2/s to the next sample in the east and north, with a row of 0 before
            and after the raster's. old_fluxes: those of the step before.
        outflow_fraction: float64 [rows + 2, columns], fraction of its outflow for which a sample has water.
    """

    bed: np.ndarray
    water: np.ndarray
    metres: tuple[float, float]
    rough: float
    rain: np.ndarray
    outlets: np.ndarray
    deep: np.ndarray
    left: float
    fluxes: np.ndarray
    old_fluxes: np.ndarray
    outflow_fraction: np.ndarray
    threads: int = 1

    @property
    def volume(self) -> float:
        """Return the m^3 of water on the ground and of water that has left; it is constant without rain."""
        samples = math.fsum(self.water.ravel().tolist()) + self.left
        return samples * self.metres[0] * self.metres[1]


def still(
    bed: np.ndarray,
    metres: tuple[float, float],
    *,
    sea: float = -math.inf,
    surge: float = 0.0,
    rain: float | np.ndarray = 0.0,
    rough: float = 0.05,
    missing: np.ndarray | None = None,
    threads: int = 1,
) -> Flood:
    """Return a flood without fluxes, with water `surge` metres above the `sea` level over ground below that level.

    bed: heights in metres. metres: between samples, east and north. rough: Manning's coefficient. rain: m/s, one number
    or one for each sample. missing: bool [rows, columns], holes, where water vanishes. Beyond the border is the sea
    without the surge, or land that water leaves to.
    """
    bed = np.ascontiguousarray(bed, np.float32)
    holes = np.zeros(bed.shape, bool) if missing is None else missing
    # The sum of depth and bed, both of single precision, is exact in float64, so that still water stays still.
    below_sea = float(np.float32(sea)) - bed.astype(np.float64)
    depth = np.where((below_sea > 0.0) & ~holes, below_sea + surge, 0.0)  # of water at the start
    border = holes.copy()
    border[[0, -1]] = True
    border[:, [0, -1]] = True
    outlets = np.flatnonzero(border)
    # Depths beyond the outlets: that of the sea without the surge, or 0.
    deep = np.where(holes, 0.0, np.maximum(below_sea, 0.0)).reshape(-1)[outlets]
    # Fluxes to the east and to the north, with a row of 0 before and after those of the raster.
    fluxes, old_fluxes = (np.zeros((2, bed.shape[0] + 2, bed.shape[1])) for _ in range(2))
    rains = np.ascontiguousarray(np.broadcast_to(np.float32(rain), bed.shape))
    outflow_fraction, left = np.ones_like(fluxes[0]), 0.0  # all outflow is possible, and no water has left yet
    return Flood(
        bed=bed,
        water=depth,
        metres=metres,
        rough=rough,
        rain=rains,
        outlets=outlets,
        deep=deep,
        left=left,
        fluxes=fluxes,
        old_fluxes=old_fluxes,
        outflow_fraction=outflow_fraction,
        threads=threads,
    )


def longest_step(flood: Flood) -> float:
    """Return the longest stable step in seconds: sqrt((1 - 2 s) / (g h (1 / dx^2 + 1 / dy^2))), h the largest depth.

    h is at least MIN_DEPTH. It is the bound of leapfrog steps for the shortest wave of the grid, where s is the
    smoothing of fluxes.
    """
    from ...kernels.land import flood as kernels

    dx, dy = flood.metres
    deepest = max(float(flood.water.max()), MIN_DEPTH)
    return math.sqrt((1.0 - 2.0 * kernels.SMOOTHING) / (GRAVITY * deepest * (1.0 / dx**2 + 1.0 / dy**2)))


def step_once(flood: Flood, seconds: float) -> None:
    """Advance the flood by one step of time.

    Raises TerrainError if it is longer than `longest_step`, where the method is unstable. seconds: length of the step.
    """
    longest = longest_step(flood)
    if not 0.0 < seconds <= longest:
        raise TerrainError(
            f"A step of the flood is {seconds:g} s long",
            expected=f"at most {longest:g} s where water is {flood.water.max():.3g} m deep",
            fix="call march, which divides the time",
        )
    _advance(flood, seconds)


def march(flood: Flood, seconds: float, progress: Callable[[float], None] = lambda _part: None) -> int:
    """Advance by `seconds` in steps of at most SAFE times the longest stable one; return their number.

    progress: called with the finished fraction after each step but the last.
    """
    now, steps = 0.0, 0
    while now < seconds:
        left = seconds - now
        # Equal steps to the end at the present depth, so that the last one is not tiny.
        dt = left / math.ceil(left / (SAFE * longest_step(flood)))
        _advance(flood, dt)
        now, steps = now + dt, steps + 1
        if dt == left:
            break
        progress(now / seconds)
    return steps


def _advance(flood: Flood, dt: float) -> None:
    """Advance a flood by `dt` seconds in place: compute fluxes, limit them to the water there is, move it.

    Outlets keep the depth beyond the border; water that leaves there is added to `flood.left`, and water that enters
    is subtracted.
    """
    from ...kernels import wp
    from ...kernels.land import flood as kernels

    flood.fluxes, flood.old_fluxes = flood.old_fluxes, flood.fluxes
    s = kernels.FloodStep()
    s.height, s.width = flood.bed.shape
    s.step_x, s.step_y = flood.metres
    s.seconds, s.rough = dt, flood.rough
    s.bed, s.rain, s.depth = flat(flood.bed, wp.float32), flat(flood.rain, wp.float32), flat(flood.water, wp.float64)
    # Kernels count rows from the raster's first, which is row 1 of these arrays.
    s.was_east, s.was_north = (flat(a[1:], wp.float64) for a in flood.old_fluxes)
    s.east, s.north = (flat(a[1:], wp.float64) for a in flood.fluxes)
    s.outflow_fraction = flat(flood.outflow_fraction[1:], wp.float64)
    for phase in (kernels.update_fluxes, kernels.limit_outflow, kernels.update_depths):
        launch.spread(phase, s.height, [s], step="flood", threads=flood.threads, cost=flood.bed.shape[1] / 4)
    # The depth at an outlet is that beyond it; a surplus has left the raster, a deficit has come in.
    water = flood.water.reshape(-1)
    flood.left += float(np.sum(water[flood.outlets] - flood.deep))
    water[flood.outlets] = flood.deep


def speeds(flood: Flood) -> np.ndarray:
    """Return the speeds, float32 [rows, columns] m/s: the mean flux of both sides over the depth.

    They are at most critical, sqrt(g depth), the speed of waves. `flood.fluxes`, [2, rows + 2, columns], go to the next
    sample in the east and north; a row of 0 is before and after the raster's rows.
    """
    to_east, to_north = flood.fluxes[0, 1:-1], flood.fluxes[1, 1:-1]
    x, y = to_east.copy(), to_north + flood.fluxes[1, :-2]  # each with the flux from the west or south: twice the mean
    x[:, 1:] += to_east[:, :-1]
    through = 0.5 * np.sqrt(x * x + y * y)
    critical = np.sqrt(GRAVITY * flood.water)
    return np.minimum(through / np.maximum(flood.water, MIN_DEPTH_OF_SPEED), critical).astype(np.float32)


def _check_time(flood: Flood, seconds: float) -> None:
    """Raise TerrainError if a flood of `seconds` would take more than MAX_STEPS steps at its present depth."""
    steps = seconds / (SAFE * longest_step(flood))
    if steps > MAX_STEPS:
        raise TerrainError(
            f"A flood of {seconds / 60.0:g} minutes would take {steps:,.0f} steps where water is "
            f"{flood.water.max():.4g} m deep and samples are {min(flood.metres):.3g} m apart",
            expected=f"at most {MAX_STEPS:,}",
            fix=f"take {seconds / 60.0 * MAX_STEPS / steps:.2g} minutes, a lower sea, or a coarser raster",
        )


def apply(ground: OperatorGround, values: Mapping[str, float], coarser: Change | None) -> Change:
    """Return the depth and speed of a flood after `minutes`; heights stay, and the coarser level is not read.

    values: the operator's parameters by name.
    """
    rain = values["rain"] / 1000.0 / HOUR
    flood = still(
        ground.heights,
        (ground.step_x, ground.step_y),
        sea=values["sea"],
        surge=values["surge"],
        rain=rain if ground.mask is None else rain * ground.mask,
        rough=values["roughness"],
        missing=ground.missing,
        threads=ground.threads,
    )
    _check_time(flood, 60.0 * values["minutes"])  # raises if that would take too many steps
    march(flood, 60.0 * values["minutes"], ground.progress)
    layers = {DEPTH.name: flood.water.astype(np.float32), SPEED.name: speeds(flood)}
    return Change(np.zeros(flood.bed.shape, np.float32), layers)


def example(evaluate: Evaluate) -> None:
    """Assert that a sea at rest keeps its bits, and that a basin holds 60 mm everywhere after an hour of such rain.

    evaluate(name, heights, step, **parameters): applies an operator to heights `step` metres apart over all levels.
    """
    bed = np.tile(np.float32(-5.0) + np.arange(16, dtype=np.float32), (12, 1))
    layers = evaluate("flood", bed, step=7.0, sea=0.25, rain=0.0, minutes=5.0).layers
    assert (layers["water_depth"] == np.maximum(np.float32(0.25) - bed, 0.0)).all()
    assert (layers["water_speed"] == 0.0).all()
    basin = np.full((13, 11), 50.0, np.float32)
    basin[1:-1, 1:-1] = 0.0
    depth = evaluate("flood", basin, step=7.0, sea=-1.0, rain=60.0, minutes=60.0).layers["water_depth"]
    assert abs(depth[1:-1, 1:-1] - 0.06).max() < 1e-4


FLOOD = HeightOperator(
    name="flood",
    label="Flood",
    about="Water after some minutes of a cloudburst or a storm surge; heights stay",
    apply=apply,
    kernels=("land.flood",),
    example=example,
    parameters=(
        Parameter("minutes", 60.0, 0.0, 2880.0, "min", "How long the rain and the flood last"),
        Parameter("rain", 50.0, 0.0, 1000.0, "mm/h", "Rain during the whole time, where the mask lets it fall"),
        Parameter("sea", 0.0, -12000.0, 9000.0, "m", "Height of the sea: all lower ground is under water"),
        Parameter("surge", 0.0, 0.0, 500.0, "m", "How much higher the sea stands at the start, as in a storm"),
        Parameter("roughness", 0.05, 0.005, 0.5, "s/m^(1/3)", "How much ground slows water: Manning's coefficient"),
    ),
    layers=(DEPTH, SPEED),
    halo=lambda _values, _step: math.inf,
    finest=513,
    masks=True,
    limit="steps of 0.95 / sqrt(g h (1 / dx^2 + 1 / dy^2)) seconds at most; longer times are divided",
    conserves="water that stands, has left and has rained: 1e-13",
    converges="of a real valley mean depth to 2 %, more than 10 cm on 55, 40, 38 km2 at 129 to 513 samples",
    cost_ns=11_000,
    source="Bates, Horritt and Fewtrell 2010; de Almeida et al. 2012; Mei, Decaudin and Hu 2007 (limited fluxes)",
)
