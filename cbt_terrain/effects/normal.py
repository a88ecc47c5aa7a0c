# SPDX-License-Identifier: GPL-3.0-or-later
"""The detail normal: of the ground as wide as a pixel, where the mesh's own are of the finest samples."""

import numpy as np

from .decals import DECALS
from .effect import Effect, Evaluate
from .jet import HALO, SOURCE, make


def example(evaluate: Evaluate) -> None:
    """Ground that rises to the east by 45 degrees faces west and up."""
    normal = evaluate("detail_normal", np.tile(np.arange(17) * 10.0, (17, 1)), step=10.0)
    assert abs(normal - np.array([-np.sqrt(0.5), 0, np.sqrt(0.5)])).max() < 1e-6


DETAIL_NORMAL = Effect(
    name="detail_normal",
    about="Normal of the ground at the scale that is shown, in the terrain's own space: near by the detail's, far away "
    "the land's beneath it",
    unit="",
    make=make,
    example=example,
    width=3,
    parameters=(DECALS,),
    halo=HALO,
    span=(-1.0, 1.0),
    cost_ns=60,
    source='Olano and Baker 2010, "LEAN mapping", section 2 (the mean normal of a footprint); ' + SOURCE,
)
