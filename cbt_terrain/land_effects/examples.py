# SPDX-License-Identifier: GPL-3.0-or-later
"""What the examples of declarations apply effects to: small rasters of which it is known what becomes of them."""

import numpy as np

from .catalogue import LAND_EFFECTS
from .land_effect import Change, Ground
from .levels import apply_by_levels


def shape_with(name: str, heights: np.ndarray, step: float, **parameters) -> Change:
    """The change that an effect makes to float32 [rows, columns] m, samples `step` metres apart, over all levels."""
    effect = LAND_EFFECTS[name]
    ground = Ground(np.asarray(heights, np.float32), step, step)
    return apply_by_levels(effect, ground, effect.defaults() | parameters)
