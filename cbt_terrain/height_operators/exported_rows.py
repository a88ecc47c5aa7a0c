# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of the heights and layers of a store for exported rasters, with the raster's step or another one."""

from collections.abc import Iterator

import numpy as np

from ..field.heightfield import HeightField
from ..query.grid import grid_axes, heights_on_grid

LINES = 256  # rows of a strip: whole blocks of GeoTIFF and OpenEXR
MAX_COLUMNS = 1 << 14  # of a strip that are computed together
HEIGHTS = "heights"


class ExportedRows:
    """The rows of heights or of a layer, from the north.

    Without a step these are the samples of the raster, of heights with finer tiles the points of the surface there.
    With one they are points of the surface, bilinear between the values of a layer.

    Attributes:
        axes: positions of columns, and of rows; `inside` is the number of them.
    """

    def __init__(self, field: HeightField, name: str, step: float) -> None:
        """Prepare the rows; nothing is read. name: HEIGHTS or a layer's. step: metres, 0 for that of the raster.

        Raises TerrainError for an impossible step.
        """
        self.axes = grid_axes(field.lattice, step)
        # Samples are copied; other rows are computed on the surface.
        self._is_copied = not step and (name != HEIGHTS or field.raster.finer is None)
        self._field = field
        if name != HEIGHTS:
            self._field = field.with_raster(samples=field.layers[name], steps=None, finer=None)

    def strips(self) -> Iterator[np.ndarray]:
        """Yield the rows in strips of LINES, the last of fewer, float32 [rows, columns]; NaN in holes."""
        height = self.axes[1].inside
        for first in range(0, height, LINES):
            end = min(first + LINES, height)
            yield self._copied(first, end) if self._is_copied else self._computed(first, end)

    def _copied(self, first: int, end: int) -> np.ndarray:
        """Return the rows `first` to `end` (exclusive) as copies of the raster's samples; a missing sample is NaN.

        Rows are counted from the north.
        """
        height = self._field.lattice.height  # rows of the field are counted from the south
        rows = slice(height - end, height - first)
        copied = np.array(self._field.heights(rows), np.float32)
        if self._field.valid is not None:
            copied[self._field.valid[rows] == 0] = np.nan
        return copied[::-1]

    def _computed(self, first: int, end: int) -> np.ndarray:
        """Return the rows `first` to `end` (exclusive) of points interpolated on the surface; those in holes are NaN.

        Rows are counted from the north.
        """
        columns, rows = self.axes[0], self.axes[1].positions(first, end, is_reversed=True)
        computed = np.empty((end - first, columns.inside), np.float32)
        for column in range(0, columns.inside, MAX_COLUMNS):
            part = computed[:, column : column + MAX_COLUMNS]
            heights, has_ground = heights_on_grid(self._field, columns.positions(column, column + part.shape[1]), rows)
            part[...] = heights
            part[~has_ground] = np.nan
        return computed
