# SPDX-License-Identifier: GPL-3.0-or-later
"""The height fields that queries are tested on: one raster that does not fit its lattice, under every surface."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.codes import Steps
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.displacement_layers import DisplacementLayer, DisplacementLayers, LayerMask
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField, with_detail
from fields import rough

SHAPE, STEP = (71, 113), 7.0
ROUGH = rough(*SHAPE, step=STEP)


def _surfaces() -> dict[str, HeightField]:
    cubic = interpolated(ROUGH, "bicubic")
    numbers, steps = np.round((ROUGH.samples + 1000) * 16).astype(np.uint16), Steps(0, 1 / 16, -1000.0)
    mask = (np.add.outer(np.arange(SHAPE[0]), np.arange(SHAPE[1])) % 256).astype(np.uint8)
    masked = DisplacementLayers(
        (DisplacementLayer(Detail(2.0, 9.0)), DisplacementLayer(Detail(1.0, 5.0, seed=3), LayerMask(mask)))
    )
    return {
        "bilinear": ROUGH,
        "bicubic": cubic,
        "numbers": from_array(steps.heights(numbers), STEP).with_raster(samples=numbers, steps=steps),
        "detail": with_detail(ROUGH, Detail(1.5, 20.0)),
        "masked": with_detail(cubic, masked),
    }


SURFACES = _surfaces()


def with_holes() -> HeightField:
    """ROUGH with a large hole, a small one and a corner that is missing."""
    heights = ROUGH.samples.copy()
    heights[20:31, 40:60] = np.nan
    heights[50, 7] = heights[-4:, -3:] = np.nan
    return from_array(heights, STEP, holes=True)
