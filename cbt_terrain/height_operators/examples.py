# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluation of the declarations' examples on small rasters with known results."""

import numpy as np

from .catalogue import LAND_EFFECTS
from .height_operator import Change, Ground
from .levels import apply_by_levels


def shape_with(name: str, heights: np.ndarray, step: float, **parameters) -> Change:
    """Apply an operator over all levels to float32 [rows, columns] m, samples `step` metres apart."""
    effect = LAND_EFFECTS[name]
    ground = Ground(np.asarray(heights, np.float32), step, step)
    return apply_by_levels(effect, ground, effect.defaults() | parameters)
