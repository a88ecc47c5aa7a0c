# SPDX-License-Identifier: GPL-3.0-or-later
"""Plan curvature: how contour lines bend."""

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
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
    example=example,
    halo=HALO,
    cost_ns=60,
    source='Evans 1980, "An integrated system of terrain analysis and slope mapping"; ' + SOURCE,
)
