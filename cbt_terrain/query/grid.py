# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights on a grid of evenly spaced samples, exact where they are samples of the raster or of its finer tiles."""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..run import launch
from ..run.buffers import shared

SNAPPED = 1e-5  # a step that differs by less, relatively, from a simple part of the raster's is taken for that part
MAX_DENOMINATOR = 1 << 20
MAX_SAMPLES = 1 << 30  # along a side
MAX_GRID = 1 << 36  # samples of an exported grid that is finer than its raster: about an hour, 137 GB of 16 bits
COST = 2.0  # of a height, times dearer than a lookup


class CellPositions(NamedTuple):
    """Positions along one axis of a raster: cells, int32 [n], and fractions of a cell, float64 [n], 0 .. 1."""

    cells: np.ndarray
    fractions: np.ndarray


@dataclass(frozen=True)
class GridAxis:
    """Evenly spaced positions along one axis of a raster, from one of its borders on.

    Attributes:
        samples: of the raster.
        step: metres between them.
        num, den: positions are num / den cells of the raster apart.
    """

    samples: int
    step: float
    num: int = 1
    den: int = 1

    @property
    def length(self) -> float:
        """Return the length of the raster, metres."""
        return (self.samples - 1) * self.step

    @property
    def spacing(self) -> float:
        """Return the distance of two positions, metres."""
        return self.num * self.step / self.den

    @property
    def inside(self) -> int:
        """Return the number of positions on the raster."""
        return (self.samples - 1) * self.den // self.num + 1

    def positions(self, first: int, end: int, is_reversed: bool = False) -> CellPositions:
        """Return the positions `first` to `end` (exclusive); those beyond the raster are at its other border.

        is_reversed: count positions from the raster's last sample backwards.
        """
        last = (self.samples - 1) * self.den  # all offsets are in 1 / den cells
        offsets = np.minimum(np.arange(first, end, dtype=np.int64) * self.num, last)
        offsets = last - offsets if is_reversed else offsets
        cells = np.minimum(offsets // self.den, self.samples - 2)
        return CellPositions(cells.astype(np.int32), (offsets - cells * self.den) / self.den)


def grid_axes(lattice: Lattice, step: float = 0.0) -> tuple[GridAxis, GridAxis]:
    """Return the axes along x and y of a grid over a raster. step: metres between samples; 0 for those of the raster.

    A step that is nearly a simple part or multiple of the raster's becomes one, so samples coincide. Raises
    TerrainError for a step with fewer than two samples along a side or more than MAX_SAMPLES.
    """
    sides = (lattice.width, lattice.step_x), (lattice.height, lattice.step_y)
    if not step:
        return GridAxis(*sides[0]), GridAxis(*sides[1])
    shortest, longest = (extreme((samples - 1) * cell for samples, cell in sides) for extreme in (min, max))
    if not longest / MAX_SAMPLES < step <= shortest * (1.0 + SNAPPED):
        expected = f"more than {longest / MAX_SAMPLES:.3g} and at most {shortest:g} m"
        raise TerrainError(f"The step of exported heights is {step:g} m", expected=expected)
    across, down = (GridAxis(samples, cell, *_ratio_of(step / cell)) for samples, cell in sides)
    return across, down


def _ratio_of(cells: float) -> tuple[int, int]:
    """Return a number of cells as a ratio of two integers: n / 1 or 1 / n if it is nearly that."""
    whole, part = max(round(cells), 1), max(round(1.0 / cells), 1)
    if min(whole, part) == 1 and abs(cells * part / whole - 1.0) < SNAPPED:
        return whole, part
    ratio = Fraction(cells).limit_denominator(MAX_DENOMINATOR)
    return ratio.numerator, ratio.denominator


def check_grid_size(axes: tuple[GridAxis, GridAxis], sample_bytes: int) -> None:
    """Raise TerrainError if a grid has more than MAX_GRID samples, and more than its raster.

    sample_bytes: size of a sample in all files of the export together.
    """
    across, down = axes
    count, limit = across.inside * down.inside, max(MAX_GRID, across.samples * down.samples)
    if count <= limit:
        return
    # The least spacing s with (length / s + 1) (length / s + 1) <= limit, rounded up to three digits.
    lengths = across.length + down.length
    root = math.sqrt(lengths**2 + 4.0 * (limit - 1) * across.length * down.length)
    spacing = (lengths + root) / (2.0 * (limit - 1))
    digit = 10.0 ** (math.floor(math.log10(spacing)) - 2)
    raise TerrainError(
        f"The export would have {count:,} samples, {1e-9 * count * sample_bytes:,.0f} GB",
        expected=f"{limit:,} samples at most",
        fix=f"choose samples {math.ceil(spacing / digit) * digit:.3g} m or more apart",
    )


def heights_on_grid(
    field: HeightField, columns: CellPositions, rows: CellPositions, threads: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights of all rows and columns, float64 [rows, columns] metres, and where there is ground, bool.

    columns, rows: the cell of the raster that contains each column and row, and the position in it, 0 .. 1. Holes have
    heights, too. The displacement of the field is included.
    """
    from ...kernels import wp
    from ...kernels.query import grid as kernels
    from .surface import pack_surface

    surface, shape = pack_surface(field, 1.0, 0.0), (len(rows.cells), len(columns.cells))
    heights, has_ground = np.empty(shape), np.empty(shape, bool)
    inputs = [surface, shared(columns.cells, wp.int32), shared(columns.fractions, wp.float64)]
    inputs += [shared(rows.cells, wp.int32), shared(rows.fractions, wp.float64)]
    inputs += [shared(heights.reshape(-1), wp.float64), shared(has_ground.reshape(-1), wp.bool)]
    launch.spread(kernels.grid_heights, shape[0], inputs, step="query", threads=threads, cost=COST * shape[1])
    return heights, has_ground
