# SPDX-License-Identifier: GPL-3.0-or-later
"""Profile curvature: how the ground bends down the slope."""

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
    """A slope that steepens downhill, z = -k x^2 / 2, bends as that parabola does: by k / (1 + (k x)^2)^(3/2)."""
    k, x = 0.02, 40.0 + np.arange(17) * 2.0
    heights = np.tile(-k * x**2 / 2, (17, 1))
    expected = k / (1 + (k * x[2:-2]) ** 2) ** 1.5
    assert abs(evaluate("profile_curvature", heights, step=2.0) - expected).max() < 1e-6
    assert abs(evaluate("profile_curvature", -heights, step=2.0) + expected).max() < 1e-6


PROFILE_CURVATURE = Effect(
    name="profile_curvature",
    about="Curvature down the slope: positive where it steepens downhill, negative at its foot; 0 on level ground",
    unit="1/m",
    make=make,
    example=example,
    halo=HALO,
    cost_ns=60,
    source='Evans 1980, "An integrated system of terrain analysis and slope mapping"; ' + SOURCE,
)
