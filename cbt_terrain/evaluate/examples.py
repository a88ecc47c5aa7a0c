# SPDX-License-Identifier: GPL-3.0-or-later
"""What the examples of declarations evaluate effects on: small rasters whose values are known."""

import numpy as np

from ..effects.effect import Asked, Places
from ..field.build import from_array
from .evaluate import values_at


def evaluate_on(name: str, heights: np.ndarray, step: float, level: float = 0.0, **parameters) -> np.ndarray:
    """An effect at every inner sample of a raster, whose samples are `step` metres apart: float32 [rows - 4,
    columns - 4], or with the effect's width."""
    field = from_array(np.asarray(heights, np.float32), step)
    lattice = field.lattice
    west, south, _, _ = lattice.rectangle()
    x = west + np.arange(lattice.width) * step
    y = south + np.arange(lattice.height) * step
    inner = np.stack([*np.meshgrid(x, y), field.heights()], -1).astype(np.float32)[2:-2, 2:-2]
    grid = inner.reshape(-1, 3)
    places = Places(field, grid, np.full(len(grid), level, np.float32))
    values = values_at(places, [Asked(name, (), parameters=tuple(parameters.items()))])[name]
    return values.reshape(*inner.shape[:2], *values.shape[1:])
