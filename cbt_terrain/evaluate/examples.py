# SPDX-License-Identifier: GPL-3.0-or-later
"""What the examples of declarations evaluate effects on: small rasters whose values are known."""

import numpy as np

from ..effects.effect import Asked
from ..field.build import from_array
from .evaluate import on_samples


def evaluate_on(name: str, heights: np.ndarray, step: float, level: float = 0.0, **parameters) -> np.ndarray:
    """An effect at every inner sample of a raster, whose samples are `step` metres apart: float32 [rows - 4,
    columns - 4], or with the effect's width."""
    field = from_array(np.asarray(heights, np.float32), step)
    asked = [Asked(name, (), parameters=tuple(parameters.items()))]
    return np.concatenate([values[name] for _, values in on_samples(field, asked, level=level)])[2:-2, 2:-2]
