# SPDX-License-Identifier: GPL-3.0-or-later
"""Mean curvature: how the ground bends, all directions together."""

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
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
    example=example,
    halo=HALO,
    cost_ns=55,
    source='Shary 1995, "Land surface in gravity points classification"; ' + SOURCE,
)
