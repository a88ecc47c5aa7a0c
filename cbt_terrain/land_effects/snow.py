# SPDX-License-Identifier: GPL-3.0-or-later
"""Snow: falls where it is cold, less where the wind blows, melts in the sun, and slides off what is too steep."""

import math
from collections.abc import Mapping

import numpy as np
import warp as wp

from ...kernels.land import snow as kernels
from ..ask.linear import length
from ..effects.effect import Parameter
from ..effects.light import azimuths
from ..effects.sky_layer import sweep
from ..run import launch
from ..run.buffers import flat
from .balance import balanced
from .land_effect import Change, Evaluate, Ground, LandEffect, LandLayer
from .levels import coarser as halved
from .levels import finer

# Azimuths of the sky; degrees to both sides of the wind from which shelter counts, too.
AZIMUTHS, GUSTS = 8, (-20.0, 0.0, 20.0)
# Sweeps of slides a level, of the coarsest so many times as many; samples around a tile that decide its own, a sweep.
SWEEPS, AT_FIRST, REACH = 12, 4, 3.2
# Metres around a tile whose horizons are looked at: from further off come those of the coarser level.
HORIZON = 300.0
# Water of this depth, metres, melts what falls into it.
WET = 0.05


def apply(ground: Ground, values: Mapping[str, float], coarser: Change | None) -> Change:
    """See Apply in land_effect.py."""
    fallen, stuck = _fallen(ground, values)
    loose = start = fallen - stuck
    if coarser is not None:
        seen, clung = _seen_coarsely(ground, values)
        before = coarser.layers["snow"] - coarser.layers["slides"]
        # What comes of ground further off than a tile looks, the coarser level knows; of the whole this is 0.
        fallen = np.maximum(fallen + (before - seen), 0.0)
        fallen[_bare(ground) != 0] = 0.0
        stuck = np.minimum(stuck, fallen)
        loose = fallen - stuck
        start = _brought(loose, coarser.layers["slides"], before - clung, ground)
    ground.progress(0.5)
    sweeps = SWEEPS if coarser is not None else SWEEPS * AT_FIRST
    slides = _slid(ground, values, stuck, start.copy(), sweeps) - loose
    _run_out(slides, ground, values)
    snow = np.maximum(fallen + slides, 0.0)
    return Change(np.float32(values["thickness"]) * snow, {"snow": snow, "slides": slides})


def _fallen(ground: Ground, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """float32 [rows, columns] m: the snow that has fallen and stayed, and what of it clings to the ground."""
    heights, (rows, columns) = np.ascontiguousarray(ground.heights), ground.heights.shape
    found, sky, lee, fallen, stuck = (np.zeros((rows, columns), np.float32) for _ in range(5))

    def slopes(azimuth: np.ndarray) -> np.ndarray:
        """Of the horizons over an azimuth."""
        sweep(heights, (ground.step_x, ground.step_y), azimuth, 1.0, ground.threads, found, ground.first)
        return found

    for azimuth in azimuths()[:AZIMUTHS]:
        sky += np.float32(1.0 / AZIMUTHS) / (1 + np.square(slopes(azimuth)))  # the sky that is above them
    for gust in GUSTS:  # sines of their heights: to windward for shelter, to leeward against it
        windward = _towards(values["wind"] + gust)
        lee += np.float32(1.0 / len(GUSTS)) * slopes(windward) / np.sqrt(1 + np.square(found))
        lee -= np.float32(1.0 / len(GUSTS)) * slopes(-windward) / np.sqrt(1 + np.square(found))
    arrays = [flat(heights, wp.float32), flat(_bare(ground), wp.uint8), *(flat(a, wp.float32) for a in (sky, lee))]
    inputs = [_weather(ground, values), *arrays, flat(fallen, wp.float32), flat(stuck, wp.float32)]
    launch.spread(kernels.lay, rows, inputs, step="snow", threads=ground.threads, cost=5 * columns)
    if ground.mask is not None:
        fallen *= ground.mask
        stuck = np.minimum(stuck, fallen)
    return fallen, stuck


def _towards(degrees: float) -> np.ndarray:
    """float64 [2]: the unit vector towards a compass bearing; rounded, so that every machine has the same."""
    turned = math.radians(degrees)
    return np.array([math.sin(turned), math.cos(turned)]).astype(np.float32).astype(np.float64)


def _bare(ground: Ground) -> np.ndarray:
    """uint8 [rows, columns]: 1 for water and holes."""
    depth = ground.layers.get("water_depth")
    bare = np.zeros(ground.heights.shape, bool) if depth is None else depth > WET
    return (bare if ground.missing is None else bare | ground.missing).astype(np.uint8)


def _weather(ground: Ground, values: Mapping[str, float]) -> kernels.Weather:
    weather, latitude = kernels.Weather(), math.radians(values["latitude"])
    weather.height, weather.width = ground.heights.shape
    weather.per_x, weather.per_y = 1.0 / ground.step_x, 1.0 / ground.step_y
    weather.line, weather.fall, weather.aspect = values["line"], values["fall"], values["aspect"]
    # Of single precision, which hides the last bits of the C library.
    weather.sun = wp.vec2d(float(np.float32(math.cos(latitude))), float(np.float32(math.sin(latitude))))
    return weather


def _seen_coarsely(ground: Ground, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """What has fallen and what clings as the coarser level sees it from these samples alone, brought to this level."""
    odd = [n % 2 for n in ground.first]

    def coarse(samples: np.ndarray | None) -> np.ndarray | None:
        return None if samples is None else halved(np.pad(samples, [(n, 0) for n in odd], mode="edge"))

    first = (ground.first[0] // 2, ground.first[1] // 2)
    layers = {name: coarse(a) for name, a in ground.layers.items() if name == "water_depth"}
    arrays = [coarse(ground.heights), 2 * ground.step_x, 2 * ground.step_y, first, ground.whole, ground.level + 1]
    below = Ground(*arrays, coarse(ground.missing), coarse(ground.mask), layers, ground.seed, ground.threads)
    shape = [n + o for n, o in zip(ground.heights.shape, odd, strict=True)]
    fallen, stuck = (finer(a, shape)[odd[0] :, odd[1] :] for a in _fallen(below, values))
    return fallen, stuck


def _brought(loose: np.ndarray, slides: np.ndarray, loose_there: np.ndarray, ground: Ground) -> np.ndarray:
    """The loose snow after what slid at the coarser level, where `loose_there` lay: of all here the same part goes, and
    what was laid down makes up for what that makes or loses."""
    gone = np.clip(-slides / np.maximum(loose_there, np.float32(1e-6)), 0.0, 1.0) * loose
    laid = np.maximum(slides, 0.0)
    if ground.missing is not None:  # what slid to the rim of a hole is not in it
        laid[ground.missing] = 0.0
    laid, gone = balanced(laid, gone, loose, laid - gone, slides, ground)
    return loose - gone + laid


def _slid(ground: Ground, values: Mapping[str, float], stuck: np.ndarray, loose: np.ndarray, sweeps: int) -> np.ndarray:
    """float32 [rows, columns] m: where the loose snow lies when slides have come to rest. `loose` is used up."""
    slides, rest, (rows, columns) = kernels.Slides(), np.zeros_like(loose), loose.shape
    slides.height, slides.width = rows, columns
    steps = ground.step_x, ground.step_y, length((ground.step_x, ground.step_y))
    slides.falls = wp.vec3f(*(_repose(values) * step for step in steps))
    slides.bed = flat(_walled(ground.heights + stuck, ground.missing), wp.float32)
    slides.snow = flat(loose, wp.float32)
    for k in range(sweeps):
        odd = k % 2
        # To and fro: with one order always slabs of one parity would give more than the others.
        for along, parity in ((1, odd), (0, 1 - odd)):
            first = -((parity + ground.first[0]) % 2)
            inputs = [first, along, (odd + ground.first[1]) % 2, slides]
            slabs = (rows - first + 1) // 2
            launch.spread(kernels.slide, slabs, inputs, step="snow", threads=ground.threads, cost=columns / 4)
            # What is on its way is in rows of one parity after each pass; the mean of four has no such comb.
            if k >= sweeps - 2:
                rest += np.float32(0.25) * loose
        ground.progress(0.5 + 0.5 * (k + 1) / sweeps)
    return rest


def _walled(bed: np.ndarray, missing: np.ndarray | None) -> np.ndarray:
    """With NaN for holes, over whose rim nothing passes."""
    return bed if missing is None else np.where(missing, np.float32(np.nan), bed)


def _repose(values: Mapping[str, float]) -> float:
    """The slope on which snow slides; rounded, so that every machine has the same."""
    return float(np.float32(math.tan(math.radians(values["slides"]))))


def _run_out(slides: np.ndarray, ground: Ground, values: Mapping[str, float]) -> None:
    """Spread what slides have laid down by [1 2 1] / 4 along either side, in place, but over no cliff: on coarse levels
    it ends on whole samples, and its rim would show their squares."""
    laid, bed = np.maximum(slides, 0.0), _walled(ground.heights, ground.missing)
    for axis, step in ((0, ground.step_y), (1, ground.step_x)):
        passed = np.float32(0.25) * np.diff(laid, axis=axis)
        passed[~(abs(np.diff(bed, axis=axis)) <= step * _repose(values))] = 0.0
        for array in (slides, laid):
            low, high = (array[:-1], array[1:]) if axis == 0 else (array[:, :-1], array[:, 1:])
            low += passed
            high -= passed


def _halo(_values: Mapping[str, float], step: float) -> float:
    return max(HORIZON, REACH * SWEEPS * step)


def example(evaluate: Evaluate) -> None:
    """On a plane far above the line lies what falls, far below it none; and none is lost where it slides."""
    for height, depth in ((3000.0, 2.0), (0.0, 0.0)):
        snow = evaluate("snow", np.full((9, 12), height), step=20.0, line=1500.0, fall=2.0).layers["snow"]
        assert abs(snow - depth).max() < 1e-3
    tower = np.full((40, 37), 3000.0)
    tower[15:25, 15:20] += 200.0
    layers = evaluate("snow", tower, step=10.0, line=1500.0, fall=2.0).layers
    slid = layers["slides"].sum(dtype=np.float64)
    assert layers["slides"].max() > 1.0 and abs(slid) < 1e-7 * abs(layers["slides"]).sum(dtype=np.float64)


SNOW = LandEffect(
    name="snow",
    label="Snow",
    about="Snow by height, sun, wind and sky; what lies on steep ground slides",
    apply=apply,
    example=example,
    parameters=(
        Parameter("line", 600.0, -1000.0, 9000.0, "m", "Height where rain turns to snow"),
        Parameter("fall", 3.0, 0.0, 50.0, "m", "Snow that falls on open ground far above the line"),
        Parameter("wind", 225.0, 0.0, 360.0, "degrees", "Where the wind comes from, clockwise from north"),
        Parameter("aspect", 2.0, 0.0, 10.0, "K", "How much warmer a slope is in the noon sun"),
        Parameter(
            "latitude",
            46.0,
            -90.0,
            90.0,
            "degrees",
            "Where the noon sun stands: in the south, in the north where negative",
        ),
        Parameter("slides", 42.0, 20.0, 60.0, "degrees", "Slope on which snow slides"),
        Parameter("thickness", 1.0, 0.0, 1.0, "", "Part of the depth that raises the ground: 0 is a layer only"),
    ),
    layers=(
        LandLayer("snow", "m", "Depth of the snow"),
        LandLayer("slides", "m", "Snow that slides have brought; where negative, taken", signed=True),
    ),
    reads=("water_depth",),
    halo=_halo,
    masks=True,
    limit="none: two neighbours at a time come to rest",
    conserves="slides keep the snow, to 2e-8",
    converges="depth to 0.27, 0.16, 0.09 m rms from 513 to 2,049 samples of the island",
    cost_ns=640,
    source="Winstral et al. 2002 (shelter from wind); Timonen and Westerholm 2010 (horizons)",
    version=6,
)
