# SPDX-License-Identifier: GPL-3.0-or-later
"""Height: of the ground, at the scale that is shown."""

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
    """On a plane the mean about a place is the place's own height."""
    heights = np.add.outer(np.arange(17) * 3.0, np.arange(17) * 5.0)
    assert abs(evaluate("height", heights, step=10.0) - heights[2:-2, 2:-2]).max() < 1e-4


HEIGHT = Effect(
    name="height",
    about="Height of the ground as displaced: a mean over the samples that are as far apart as the scale",
    unit="m",
    make=make,
    example=example,
    halo=HALO,
    cost_ns=50,
    source=SOURCE,
)
