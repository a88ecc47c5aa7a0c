# SPDX-License-Identifier: GPL-3.0-or-later
"""The scale at which an effect is evaluated: a level of the pyramid for each place."""

from collections.abc import Sequence

import numpy as np

from ..ask.linear import inverse
from ..ask.view import View
from ..field.heightfield import HeightField
from ..mesh.surface import Surface

STEPS_PER_LEVEL = 8  # values stay bit for bit while the camera creeps


def fixed_level(surface: Surface, level: float = 0.0) -> np.ndarray:
    """float32 [V]: one scale everywhere."""
    return np.full(len(surface.positions), level, np.float32)


def footprint_levels(
    heights: HeightField, surface: Surface, views: Sequence[View], placement: np.ndarray | None
) -> np.ndarray:
    """float32 [V]: the level whose samples are a pixel apart, of the view that sees it finest, in steps of 1/8."""
    if not views:
        return fixed_level(surface)
    to_local = np.eye(4) if placement is None else inverse(placement)
    step = max(heights.lattice.step_x, heights.lattice.step_y)
    finest = np.full(len(surface.positions), np.inf, np.float64)
    for view in views:
        eye = to_local @ inverse(view.world_to_camera)[:, 3]
        metres = np.linalg.norm(surface.positions - eye[:3], axis=1) / view.pixels_per_unit
        finest = np.minimum(finest, metres)
    level = np.maximum(np.log2(np.maximum(finest / step, 1e-30)), 0.0)
    return (np.rint(level * STEPS_PER_LEVEL) / STEPS_PER_LEVEL).astype(np.float32)
