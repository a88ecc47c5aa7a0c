# SPDX-License-Identifier: GPL-3.0-or-later
"""Aspect: where the ground faces."""

import numpy as np

from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
    """Ground that falls to the east faces east: the sine is 1. An angle would jump from 360 to 0 degrees."""
    aspect = evaluate("aspect", np.tile(np.arange(17) * -4.0, (17, 1)), step=10.0)
    assert abs(aspect - np.array([1.0, 0.0])).max() < 1e-6


ASPECT = Effect(
    name="aspect",
    about="Direction downhill, clockwise from north, as its sine (to the east) and cosine (to the north); (0, 0) on "
    "level ground",
    unit="",
    make=make,
    example=example,
    width=2,
    halo=HALO,
    span=(-1.0, 1.0),
    cost_ns=55,
    source='Horn 1981, "Hill shading and the reflectance map", section II; ' + SOURCE,
)
