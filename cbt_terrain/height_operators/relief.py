# SPDX-License-Identifier: GPL-3.0-or-later
"""Relief finer than the data: rock, gullies and ledges below the spacing of the source.

`ground` is the operator's input, a level or a tile of it: heights in metres, `missing` (holes), layers, and `first`,
row and column of its first sample in the whole level. `launch.spread` runs a kernel for a number of items, each of
which takes `cost` times 15 ns.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..attributes.attribute import Parameter
from ..run import launch
from ..run.buffers import flat
from .height_operator import Change, Evaluate, HeightOperator, OperatorGround

if TYPE_CHECKING:
    from ...kernels.land.relief import ReliefNoise, Window

# Fraction of the longest wave over which the ground's slope and curvature are measured.
REACH = 0.25
BLOCK_ROWS = 256
# Metres of sediment that bury all relief, so that valley floors and filled lakes stay flat.
BURIED = 2.0
# Beds dip towards this direction (east, north).
DIP_TO = np.array([2.0, 1.0]) / math.sqrt(5.0)


def apply(ground: OperatorGround, values: Mapping[str, float], _coarser: Change | None) -> Change:
    """Return the fine relief (noise and ledges of rock) to add to the heights of a level; implements `Apply`.

    The coarser level, which only lacks the finest waves, is not needed. Sediment hides the relief. values: the
    operator's parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land.relief import add_relief

    heights = np.ascontiguousarray(ground.heights)
    # Parameters of the noise, and the position of these samples in the level, which decides its values.
    noise, window = _noise(ground, values), _window(ground, values)
    added = np.empty_like(heights)
    rows, columns = heights.shape
    for first in range(0, rows, BLOCK_ROWS):
        inputs = [first, window, noise, flat(heights, wp.float32), flat(added, wp.float32)]
        count, cost = min(BLOCK_ROWS, rows - first), 2.0 * (noise.octaves + 1) * columns
        launch.spread(add_relief, count, inputs, step="relief", threads=ground.threads, cost=cost)
        ground.progress((first + count) / rows)
    if "sediment" in ground.layers:  # hides it, all of it from BURIED metres on
        added *= np.clip(1.0 - ground.layers["sediment"] * np.float32(1.0 / BURIED), 0.0, 1.0, dtype=np.float32)
    if ground.missing is not None:
        added[ground.missing] = 0.0
    return Change(added)


def _noise(ground: OperatorGround, values: Mapping[str, float]) -> "ReliefNoise":
    """Return the parameters of the noise and of the beds of rock for kernels; octaves end at waves of two samples.

    Beds dip in the direction DIP_TO (east, north). values: the operator's parameters by name.
    """
    from ...kernels import wp
    from ...kernels.land.relief import ReliefNoise

    noise = ReliefNoise()
    spacing = max(ground.step_x, ground.step_y)
    noise.octaves = max(0, math.ceil(math.log2(values["wave"] / (2.0 * spacing))))
    noise.seed = wp.uint32(ground.seed & 0xFFFFFFFF)
    noise.wave, noise.rough, noise.plain = values["wave"], values["roughness"], values["plains"]
    noise.gain, noise.ridge = values["gain"], values["ridges"]
    noise.bed, noise.ledge = values["beds"], values["ledges"]
    noise.dip = wp.vec2d(*(-math.tan(math.radians(values["dip"])) * DIP_TO))
    return noise


def _window(ground: OperatorGround, values: Mapping[str, float]) -> "Window":
    """Return the window of samples for kernels, with the distance, in samples, over which slopes are averaged.

    values: the operator's parameters by name.
    """
    from ...kernels.land.relief import Window

    window = Window()
    window.height, window.width = ground.heights.shape
    window.row, window.column = ground.first
    window.step_x, window.step_y = ground.step_x, ground.step_y
    window.reach_x = max(1, round(REACH * values["wave"] / ground.step_x))
    window.reach_y = max(1, round(REACH * values["wave"] / ground.step_y))
    return window


def _example(evaluate: Evaluate) -> None:
    """Assert that level ground stays, and that roughness and rock beds have their heights.

    evaluate(name, heights, step, **parameters): applies an operator to heights `step` metres apart over all levels.
    """
    level = evaluate("relief", np.full((40, 50), 300.0), step=10.0, plains=0.0)
    assert not level.heights.any()
    slope = 4.0 * np.arange(200)[None, :] + np.zeros((150, 1))
    rough = evaluate("relief", slope, step=10.0, wave=160.0, roughness=0.3).heights
    # 24 m: the roughness over half a wave; 0.4: the slope.
    assert 0.02 * 24.0 * 0.4 < rough.std() < 24.0 * 0.4
    beds = evaluate("relief", slope, step=10.0, wave=20.0, roughness=0.0, plains=0.0, beds=60.0, dip=0.0).heights
    assert 2.0 < np.abs(beds).max() < 60.0


RELIEF = HeightOperator(
    name="relief",
    label="Fine Relief",
    about="Rock, gullies and ledges that are finer than the height map, by the slope and the bend of the ground",
    apply=apply,
    kernels=("land.relief",),
    example=_example,
    reads=("sediment",),
    parameters=(
        Parameter("wave", 100.0, 0.1, 10_000.0, "m", "Largest new forms: about four times the spacing of heights"),
        Parameter("roughness", 0.3, 0.0, 2.0, "", "Height on slopes of 45°, as a fraction of half the wave's length"),
        Parameter("plains", 0.01, 0.0, 1.0, "", "The same on level ground: small for smooth plains"),
        Parameter("gain", 0.47, 0.0, 0.9, "", "Height of a form to that of one twice as large: higher is rougher"),
        Parameter("ridges", 0.9, 0.0, 1.0, "", "How sharp crests and ridges become: 0 is round"),
        Parameter("beds", 0.0, 0.0, 1000.0, "m", "Mean thickness of the rock layers that show on slopes; 0: none show"),
        Parameter("ledges", 0.9, 0.0, 1.0, "", "How far hard rock layers stand out on slopes"),
        Parameter("dip", 2.0, 0.0, 45.0, "degrees", "Tilt of the rock layers, down to the east-north-east"),
    ),
    halo=lambda values, step: REACH * values["wave"] + step,
    limit="none: a function of the place; waves under two spacings are left out",
    conserves="nothing: it replaces detail that the data lacks",
    converges="half the spacing adds 0.45 of the addition before it, which is the gain of its waves",
    cost_ns=110.0,
    source="Musgrave, Kolb and Mace (1989), section 2; Quilez, more noise (2008); Perlin, Improving noise (2002)",
)
