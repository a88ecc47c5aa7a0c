# SPDX-License-Identifier: GPL-3.0-or-later
"""Snow: it falls by temperature, wind, sun and sky, and slides off steep ground.

`ground` is the operator's input, a level or a tile of it: heights in metres, `missing` (holes), `mask`, layers, and
`first`, row and column of its first sample in the whole level. `launch.spread` runs a kernel for a number of items,
each of which takes `cost` times 15 ns.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..attributes.attribute import Parameter
from ..attributes.light import azimuths
from ..run import launch
from ..run.buffers import flat
from ..view.linear import length
from .balance import balance_mass
from .height_operator import Change, Evaluate, HeightOperator, LandLayer, OperatorGround
from .levels import coarser as halved
from .levels import coarser_ground, finer

if TYPE_CHECKING:
    from ...kernels.land import snow as kernels

# Azimuths of the sky; directions of shelter relative to the wind in degrees.
AZIMUTHS, GUSTS = 8, (-20.0, 0.0, 20.0)
# Sweeps of slides on a level, their factor at the coarsest level, and samples of halo for each sweep.
SWEEPS, AT_FIRST, REACH = 12, 4, 3.2
# Metres around a tile that its horizons see; the coarser level adds the terrain beyond.
HORIZON = 300.0
# Metres of water that melt the snow that falls into them.
WET = 0.05


def apply(ground: OperatorGround, values: Mapping[str, float], coarser: Change | None) -> Change:
    """Return the snow on a level: the change of heights, and the depth of snow and of slides as layers.

    values: the parameters by name. coarser: the change of the next coarser level, interpolated to this one.
    """
    snowfall, clinging = _snowfall(ground, values)
    loose = start = snowfall - clinging  # snow that may slide, and after the coarser level's slides
    if coarser is not None:
        # The coarser level's snowfall as these samples alone give it; `before` is it with the ground beyond them.
        coarse_snowfall, coarse_clinging = _coarse_snowfall(ground, values)
        before = coarser.layers["snow"] - coarser.layers["slides"]
        # Adds the influence of ground beyond a tile's halo; it is 0 for the whole level.
        snowfall = np.maximum(snowfall + (before - coarse_snowfall), 0.0)
        snowfall[_where_no_snow(ground) != 0] = 0.0
        clinging = np.minimum(clinging, snowfall)
        loose = snowfall - clinging
        start = _transfer_slides(loose, coarser.layers["slides"], before - coarse_clinging, ground)
    ground.progress(0.5)
    sweeps = SWEEPS if coarser is not None else SWEEPS * AT_FIRST  # more where slides do not start from a coarser level
    slides = _slide_snow(ground, values, clinging, start.copy(), sweeps) - loose
    _smooth_deposits(slides, ground, values)
    snow = np.maximum(snowfall + slides, 0.0)
    return Change(np.float32(values["thickness"]) * snow, {"snow": snow, "slides": slides})


def _snowfall(ground: OperatorGround, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth of snow before slides, and the part of it that clings to the ground, metres.

    Both are float32 [rows, columns]. values: the operator's parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land import snow as kernels
    from ..attributes.sky_layer import sweep

    heights, (rows, columns) = np.ascontiguousarray(ground.heights), ground.heights.shape
    # sky: fraction of it that is seen. lee: shelter from the wind. horizon: slopes of the horizon in one direction.
    horizon, sky, lee, snowfall, clinging = (np.zeros((rows, columns), np.float32) for _ in range(5))

    def slopes(azimuth: np.ndarray) -> np.ndarray:
        """Return `horizon` with the slopes of the horizon in an azimuth, a unit vector to the east and north.

        `first` places the tile in the level, so that lines of sight are the same ones in every tile.
        """
        steps, first, holes = (ground.step_x, ground.step_y), ground.first, ground.missing
        sweep(heights, steps, azimuth, scale=1.0, threads=ground.threads, out=horizon, first=first, missing=holes)
        return horizon

    # Fraction of the sky that is seen, the mean over AZIMUTHS evenly spread directions.
    for azimuth in azimuths()[:AZIMUTHS]:
        sky += np.float32(1.0 / AZIMUTHS) / (1 + np.square(slopes(azimuth)))  # cos^2 of the horizon's height
    # Sines of the horizons to windward, less those to leeward (Winstral et al. 2002), the mean over GUSTS, degrees off
    # the wind's direction. `slopes` fills `horizon` before the division reads it.
    for gust in GUSTS:
        windward = _direction(values["wind"] + gust)
        lee += np.float32(1.0 / len(GUSTS)) * slopes(windward) / np.sqrt(1 + np.square(horizon))
        lee -= np.float32(1.0 / len(GUSTS)) * slopes(-windward) / np.sqrt(1 + np.square(horizon))
    arrays = [
        flat(heights, wp.float32),
        flat(_where_no_snow(ground), wp.uint8),
        *(flat(a, wp.float32) for a in (sky, lee)),
    ]
    inputs = [_weather(ground, values), *arrays, flat(snowfall, wp.float32), flat(clinging, wp.float32)]
    # An item is a row, of which the kernel writes `snowfall` and `clinging`.
    launch.spread(kernels.fall, rows, inputs, step="snow", threads=ground.threads, cost=5 * columns)
    if ground.mask is not None:
        snowfall *= ground.mask
        clinging = np.minimum(clinging, snowfall)
    return snowfall, clinging


def _direction(degrees: float) -> np.ndarray:
    """Return the unit vector of a compass bearing, float64 [2], rounded to be equal on every machine.

    degrees: clockwise from north.
    """
    angle = math.radians(degrees)
    return np.array([math.sin(angle), math.cos(angle)]).astype(np.float32).astype(np.float64)


def _where_no_snow(ground: OperatorGround) -> np.ndarray:
    """Return 1 where no snow stays, which is on water and in holes, uint8 [rows, columns]."""
    depth = ground.layers.get("water_depth")
    bare = np.zeros(ground.heights.shape, bool) if depth is None else depth > WET
    return (bare if ground.missing is None else bare | ground.missing).astype(np.uint8)


def _weather(ground: OperatorGround, values: Mapping[str, float]) -> "kernels.Weather":
    """Return the snow line, the depth of snow, the aspect and the noon sun of an equinox for kernels.

    values: the operator's parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land import snow as kernels

    weather, latitude = kernels.Weather(), math.radians(values["latitude"])
    weather.height, weather.width = ground.heights.shape
    weather.per_x, weather.per_y = 1.0 / ground.step_x, 1.0 / ground.step_y
    weather.line, weather.fall, weather.aspect = values["line"], values["fall"], values["aspect"]
    # Sine and cosine of the sun's height, 90 degrees less the latitude. Single precision hides the last bits of the C
    # library.
    weather.sun = wp.vec2d(float(np.float32(math.cos(latitude))), float(np.float32(math.sin(latitude))))
    return weather


def _coarse_snowfall(ground: OperatorGround, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return `_snowfall` of the coarser level computed from these samples alone, interpolated to this level.

    values: the operator's parameters by name.
    """
    odd = [n % 2 for n in ground.first]

    def halve_samples(samples: np.ndarray) -> np.ndarray:
        """Return samples at the next coarser level, aligned with the whole level's samples."""
        return halved(np.pad(samples, [(n, 0) for n in odd], mode="edge"))

    # `whole` stays that of this level: `_snowfall` does not read it.
    coarse = replace(coarser_ground(ground, halve_samples), first=(ground.first[0] // 2, ground.first[1] // 2))
    shape = tuple(n + o for n, o in zip(ground.heights.shape, odd, strict=True))
    snowfall, clinging = (finer(a, shape)[odd[0] :, odd[1] :] for a in _snowfall(coarse, values))
    return snowfall, clinging


def _transfer_slides(
    loose: np.ndarray, slides: np.ndarray, coarse_loose: np.ndarray, ground: OperatorGround
) -> np.ndarray:
    """Return the loose snow after the slides of the coarser level, which started from `coarse_loose`.

    The same fraction of the loose snow slides away as there; deposits are scaled so that mass is conserved. loose:
    of this level. slides, coarse_loose: the coarser level's, interpolated. All float32 [rows, columns] m.
    """
    eroded = np.clip(-slides / np.maximum(coarse_loose, np.float32(1e-6)), 0.0, 1.0) * loose
    deposited = np.maximum(slides, 0.0)
    if ground.missing is not None:  # interpolation spreads deposits into holes
        deposited[ground.missing] = 0.0
    deposited, eroded = balance_mass(
        deposited, eroded, max_eroded=loose, change=deposited - eroded, net=slides, ground=ground
    )
    return loose - eroded + deposited


def _slide_snow(
    ground: OperatorGround, values: Mapping[str, float], clinging: np.ndarray, loose: np.ndarray, sweeps: int
) -> np.ndarray:
    """Return the loose snow after `sweeps` sweeps of slides, float32 [rows, columns] m.

    It is the mean after the last four halves of sweeps. Overwrites `loose`. clinging: metres that never slide. sweeps:
    at least 2; each has two halves, slabs of two rows that begin at even and at odd rows. values: the operator's
    parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land import snow as kernels

    arguments, mean_snow, (rows, columns) = kernels.Slides(), np.zeros_like(loose), loose.shape
    arguments.height, arguments.width = rows, columns
    steps = ground.step_x, ground.step_y, length((ground.step_x, ground.step_y))
    arguments.falls = wp.vec3f(*(_repose(values) * step for step in steps))  # metres between neighbours at rest
    arguments.bed = flat(_with_walls(ground.heights + clinging, ground.missing), wp.float32)  # holes are walls
    arguments.snow = flat(loose, wp.float32)
    for k in range(sweeps):
        odd = k % 2
        # A slab that settles first gives more snow, so slabs that begin at even and at odd rows take turns in being
        # first. The first half also settles pairs of neighbours along the rows: those that begin at columns of the
        # parity `west`, and then the others.
        west = (odd + ground.first[1]) % 2
        for along, parity in ((1, odd), (0, 1 - odd)):  # along: 1 if pairs along the rows settle, too
            first = -((parity + ground.first[0]) % 2)  # -1 if only the second row of the first slab is in the raster
            inputs = [first, along, west, arguments]
            slabs = (rows - first + 1) // 2
            launch.spread(kernels.slide, slabs, inputs, step="snow", threads=ground.threads, cost=columns / 4)
            # Moving snow is in rows of one parity after each half; the mean of four halves hides that comb.
            if k >= sweeps - 2:
                mean_snow += np.float32(0.25) * loose
        ground.progress(0.5 + 0.5 * (k + 1) / sweeps)
    return mean_snow


def _with_walls(bed: np.ndarray, missing: np.ndarray | None) -> np.ndarray:
    """Return the bed with NaN in holes, which stops slides at their borders. missing: bool, holes; None for none."""
    return bed if missing is None else np.where(missing, np.float32(np.nan), bed)


def _repose(values: Mapping[str, float]) -> float:
    """Return the slope on which snow slides, rounded to be equal on every machine."""
    return float(np.float32(math.tan(math.radians(values["slides"]))))


def _smooth_deposits(slides: np.ndarray, ground: OperatorGround, values: Mapping[str, float]) -> None:
    """Smooth deposits by [1 2 1] / 4 along both axes, in place, but not over cliffs.

    On coarse levels they end at whole samples, whose squares would show. values: the operator's parameters by name.
    """
    deposited, bed = np.maximum(slides, 0.0), _with_walls(ground.heights, ground.missing)
    for axis, step in ((0, ground.step_y), (1, ground.step_x)):
        flux = np.float32(0.25) * np.diff(deposited, axis=axis)
        flux[~(abs(np.diff(bed, axis=axis)) <= step * _repose(values))] = 0.0  # cliffs, and NaN beside holes
        for array in (slides, deposited):
            low, high = (array[:-1], array[1:]) if axis == 0 else (array[:, :-1], array[:, 1:])
            low += flux
            high -= flux


def example(evaluate: Evaluate) -> None:
    """Assert the depth on planes far above and below the line, and that slides conserve mass.

    evaluate(name, heights, step, **parameters): applies an operator to heights `step` metres apart over all levels.
    """
    for height, depth in ((3000.0, 2.0), (0.0, 0.0)):
        snow = evaluate("snow", np.full((9, 12), height), step=20.0, line=1500.0, fall=2.0).layers["snow"]
        assert abs(snow - depth).max() < 1e-3
    tower = np.full((40, 37), 3000.0)
    tower[15:25, 15:20] += 200.0
    layers = evaluate("snow", tower, step=10.0, line=1500.0, fall=2.0).layers
    slid = layers["slides"].sum(dtype=np.float64)
    assert layers["slides"].max() > 1.0 and abs(slid) < 1e-7 * abs(layers["slides"]).sum(dtype=np.float64)


SNOW = HeightOperator(
    name="snow",
    label="Snow",
    about="Snow by height, sun, wind and sky; it slides off steep ground",
    apply=apply,
    kernels=("effects.pyramid", "effects.sweep", "land.snow"),
    example=example,
    parameters=(
        Parameter("line", 600.0, -1000.0, 9000.0, "m", "Height above which snow falls instead of rain"),
        Parameter("fall", 3.0, 0.0, 50.0, "m", "Depth of snow on open ground far above the line"),
        Parameter("wind", 225.0, 0.0, 360.0, "degrees", "Direction from which the wind blows, clockwise from north"),
        Parameter("aspect", 2.0, 0.0, 10.0, "K", "How much warmer slopes in the noon sun are: raises the line there"),
        Parameter("latitude", 46.0, -90.0, 90.0, "degrees", "For the noon sun: in the south, or north where below 0"),
        Parameter("slides", 42.0, 20.0, 60.0, "degrees", "Slope from which snow slides down"),
        Parameter("thickness", 1.0, 0.0, 1.0, "", "Share of the depth that raises the ground; 0: only the attribute"),
    ),
    layers=(
        LandLayer("snow", "m", "Depth of the snow"),
        LandLayer("slides", "m", "Snow that slides have brought; where negative, taken", signed=True),
    ),
    reads=("water_depth",),
    halo=lambda _values, step: max(HORIZON, REACH * SWEEPS * step),
    masks=True,
    limit="none: two neighbours at a time come to rest",
    conserves="slides keep the snow, to 2e-8",
    converges="depth to 0.27, 0.16, 0.09 m rms from 513 to 2,049 samples of the island",
    cost_ns=640,
    source="Winstral et al. 2002 (shelter from wind); Timonen and Westerholm 2010 (horizons)",
    version=6,
)
