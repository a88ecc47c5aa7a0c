# SPDX-License-Identifier: GPL-3.0-or-later
"""The evaluation of the declarations' examples on small rasters with known results."""

import numpy as np

from .catalogue import HEIGHT_OPERATORS
from .height_operator import Change, OperatorGround
from .levels import apply_by_levels


def shape_with(name: str, heights: np.ndarray, step: float, **parameters: float) -> Change:
    """Apply an operator over all levels to float32 [rows, columns] m, samples `step` metres apart."""
    effect = HEIGHT_OPERATORS[name]
    ground = OperatorGround(np.asarray(heights, np.float32), step, step)
    return apply_by_levels(effect, ground, effect.defaults() | parameters)
