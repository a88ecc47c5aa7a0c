# SPDX-License-Identifier: GPL-3.0-or-later
"""Slope: how steep the ground is."""

import math

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
    """A plane that rises 1 m in the root of 3 m has 30 degrees everywhere."""
    east = np.arange(17, dtype=np.float32) * 10.0
    slope = evaluate("slope", np.tile(east * np.float32(1 / math.sqrt(3)), (17, 1)), step=10.0)
    assert abs(slope - math.radians(30)).max() < 1e-5


SLOPE = Effect(
    name="slope",
    about="How steep the ground is: 0 is level, pi / 2 upright",
    unit="rad",
    make=make,
    example=example,
    halo=HALO,
    span=(0.0, math.pi / 2),
    cost_ns=70,
    source='Horn 1981, "Hill shading and the reflectance map", section II; ' + SOURCE,
)
