# SPDX-License-Identifier: GPL-3.0-or-later
"""The lowest and the highest height, `height * vertical_scale + vertical_offset`, in a box of the plan."""

import math

import numpy as np
import warp as wp

from ...kernels.query import boxes as kernels
from ..errors import TerrainError
from ..field.detail_bounds import highest
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..plain_numbers import plain_number
from ..run import launch
from ..run.buffers import shared
from .surface import height_ranges_of, pack_surface, widening_of


def box_range(
    field: HeightField,
    west: float,
    south: float,
    east: float,
    north: float,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
) -> tuple[float, float]:
    """Return the lowest and highest height in a box of the plan, metres; (nan, nan) without ground.

    west, south, east, north: sides of the box, metres in the terrain's space. Raises TerrainError for sides that are
    not finite or in the wrong order. Exact for a bilinear surface: in a cell its extrema are at the corners of the part
    inside the box. Of a bicubic one they are bounds: the extreme control heights of the patches that the box touches,
    rounded outward by 1/65,535 of the terrain's relief. Displacement layers widen them by their amplitude. O(cells in
    the box).
    """
    sides = [plain_number(value, float, "A side of the box") for value in (west, south, east, north)]
    west, south, east, north = sides
    if not all(map(math.isfinite, sides)) or west > east or south > north:
        raise TerrainError(
            f"The box goes from {west} to {east} m east and from {south} to {north} m north",
            expected="finite numbers, the smaller ones first",
        )
    surface, lattice = pack_surface(field, vertical_scale, vertical_offset), field.lattice
    low, high = _in_cells(sides, lattice)
    if (low > high).any():
        return math.nan, math.nan
    # With holes, the cells before a side that is on a border between cells are searched, too: the border of a hole is
    # ground, perhaps of those cells alone.
    before = low if field.valid is None else np.ceil(low) - 1
    first_column, first_row = (max(0, min(int(n), cells - 1)) for n, cells in zip(before, _cells(lattice), strict=True))
    rows = min(int(high[1]), lattice.cells_y - 1) - first_row + 1
    row_ranges = np.empty((rows, 2))
    corners = map(wp.float64, (*low, *high))
    ranges = height_ranges_of(field, surface)
    # Only by the largest displacement of layers, not by the change of finer tiles, whose heights the kernel reads.
    ranges.widening = widening_of(field, surface, highest(field.parts))
    inputs = [
        surface,
        ranges,
        first_column,
        first_row,
        *corners,
        shared(row_ranges, wp.vec2d),
    ]
    launch.spread(kernels.row_ranges, rows, inputs, step="query", threads=threads, cost=high[0] - low[0] + 1)
    low_z, high_z = float(row_ranges[:, 0].min()), float(row_ranges[:, 1].max())
    if low_z > high_z:
        return math.nan, math.nan
    # ranges of a bicubic surface include the displacement
    amplitude = 0.0 if surface.bicubic else highest(field.parts) * abs(surface.scale)
    return low_z - amplitude, high_z + amplitude


def _in_cells(sides: list[float], lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest corner of a box, float64 [2] each, in cells from the raster's south-western corner.

    They are cut at the border. sides: west, south, east and north, metres.
    """
    corner, steps = np.array(lattice.rectangle()[:2]), np.array([lattice.step_x, lattice.step_y])
    low, high = ((np.array(pair) - corner) / steps for pair in (sides[:2], sides[2:]))
    return np.maximum(low, 0.0), np.minimum(high, _cells(lattice))


def _cells(lattice: Lattice) -> tuple[int, int]:
    """Return the number of the raster's cells along x and y."""
    return lattice.cells_x, lattice.cells_y
