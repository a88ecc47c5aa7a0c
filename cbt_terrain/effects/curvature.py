# SPDX-License-Identifier: GPL-3.0-or-later
"""Curvatures: how the ground bends in all directions together, down the slope, and along a contour line."""

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make

EVANS = 'Evans 1980, "An integrated system of terrain analysis and slope mapping"; ' + SOURCE


def mean_example(evaluate: Evaluate) -> None:
    """A round summit of the radius 50 m bends by 1 / 50 m, and a hollow by as much the other way."""
    across = np.arange(-8, 9) * 2.0
    summit = np.add.outer(across**2, across**2) / (-2 * 50.0)
    middle = 6, 6  # of what is evaluated
    assert abs(evaluate("mean_curvature", summit, step=2.0)[middle] - 1 / 50.0) < 1e-6
    assert abs(evaluate("mean_curvature", -summit, step=2.0)[middle] + 1 / 50.0) < 1e-6


MEAN_CURVATURE = Effect(
    name="mean_curvature",
    about="Mean curvature of the surface: positive on summits and ridges, negative in hollows and channels",
    unit="1/m",
    make=make,
    example=mean_example,
    halo=HALO,
    cost_ns=55,
    source='Shary 1995, "Land surface in gravity points classification"; ' + SOURCE,
)


def profile_example(evaluate: Evaluate) -> None:
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
    example=profile_example,
    halo=HALO,
    cost_ns=60,
    source=EVANS,
)


def plan_example(evaluate: Evaluate) -> None:
    """Contour lines of a round hill are circles: r metres from its summit they bend by 1 / r, of a hollow by -1 / r."""
    across = np.arange(-8, 9) * 2.0
    hill = np.add.outer(across**2, across**2) / -100.0
    radius = np.hypot.outer(across, across)[2:-2, 2:-2]
    away = radius > 0
    assert abs(evaluate("plan_curvature", hill, step=2.0)[away] - 1 / radius[away]).max() < 1e-5
    assert abs(evaluate("plan_curvature", -hill, step=2.0)[away] + 1 / radius[away]).max() < 1e-5


PLAN_CURVATURE = Effect(
    name="plan_curvature",
    about="Curvature of the contour line: positive on ridges, negative in valleys; at most 1 / the distance of samples "
    "at the scale, 0 on level ground",
    unit="1/m",
    make=make,
    example=plan_example,
    halo=HALO,
    cost_ns=60,
    source=EVANS,
)
