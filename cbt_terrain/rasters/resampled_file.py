# SPDX-License-Identifier: GPL-3.0-or-later
"""Windows of a file on another grid. They have the same bits however the grid is divided into windows.

For that, positions in the file are computed by whole blocks of BLOCK x BLOCK samples of the grid: by PROJ at nodes, and
between nodes by interpolation.
"""

from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .file_grid import FileGrid, find_positions, unit_of
from .grid_pieces import (
    BLOCK,
    EDGE,
    MARGIN,
    MAX_BUFFER,
    NO_DATA,
    SNAPPED,
    SPACINGS,
    UNCOVERED,
    BlockNodes,
    GridPiece,
    LatticeWindow,
    PieceValues,
    empty_values,
    interpolation_error,
    pieces_of,
    resample_piece,
)

TOLERANCE = 0.001  # largest error of an interpolated position, file samples: 3 cm in a raster of 30 m
MAX_BLOCKS = 64  # whose nodes are kept: 17 KB each where the system is even, 4 MB where nodes are 2 samples apart


class Resampling(NamedTuple):
    """A straight grid with the north up for the samples of a file.

    Attributes:
        source: grid of the file, with a coordinate system.
        target: the new grid, with a coordinate system.
        file_size: columns and rows of the file.
        size: columns and rows of the new grid.
    """

    source: FileGrid
    target: FileGrid
    file_size: tuple[int, int]
    size: tuple[int, int]


class ResampledFile:
    """A file on another grid, read by windows.

    Attributes:
        moved: largest error that positions have made since it was last set to 0, in the unit of the file's values.
    """

    def __init__(self, plan: Resampling, read: Callable[[int, int, int, int], np.ndarray]) -> None:
        """Prepare a file. read: returns a window of it by first row, rows, first column and columns, NaN for gaps."""
        self._plan, self._read, self.moved = plan, read, 0.0
        self._nodes_of = lru_cache(maxsize=MAX_BLOCKS)(self._find_nodes)

    def window(self, first: int, count: int, column: int, columns: int) -> np.ndarray:
        """Return `columns` samples from `column` on of `count` rows from row `first` on, float64 with NaN for gaps."""
        values = np.full((count, columns), np.nan)
        for piece in pieces_of(column, first, columns, count):
            for part, result in self._parts(piece):
                top, left = part.row - first, part.column - column
                values[top : top + part.rows, left : left + part.columns] = result.values
                self.moved = max(self.moved, float(result.moved.max()))
        return values

    def _parts(self, piece: GridPiece) -> Iterator[tuple[GridPiece, PieceValues]]:
        """Yield a piece with its values, or its parts if it needs too many samples of the file at once.

        A piece beyond the file is left out.
        """
        nodes = self._nodes_of(*piece.block)
        box = self._box_of(piece, nodes)
        if box is None:
            return
        left, top, right, bottom = box
        if (right - left) * (bottom - top) > MAX_BUFFER and piece.columns * piece.rows > 1:
            for half in piece.halves():
                yield from self._parts(half)
            return
        result = empty_values(piece)
        resample_piece(piece, nodes, self._file_window(*box), result)
        yield piece, result

    def _box_of(self, piece: GridPiece, nodes: BlockNodes) -> tuple[int, int, int, int] | None:
        """Return the file's samples around a piece: first column and row, and the ends of both; None beyond the file.

        nodes: of the piece's block.
        """
        x, y, spacing = piece.column % BLOCK, piece.row % BLOCK, nodes.spacing
        around = (  # rows and columns of the nodes around the piece
            slice(y // spacing, (y + piece.rows - 1) // spacing + 2),
            slice(x // spacing, (x + piece.columns - 1) // spacing + 2),
        )
        ends = []
        # SNAPPED: a position this near to the file counts as inside. EDGE: samples that interpolation needs around it.
        for values, count in zip((nodes.u[around], nodes.v[around]), self._plan.file_size, strict=True):
            finite = values[np.isfinite(values)]
            if not finite.size or finite.max() < 0.0 - SNAPPED or finite.min() > count - 1 + SNAPPED:
                return None
            low, high = max(np.floor(finite.min()), 0.0), min(np.ceil(finite.max()), count - 1.0)
            ends.append((int(low) - EDGE, int(high) + EDGE + 1))
        return ends[0][0], ends[1][0], ends[0][1], ends[1][1]

    def _file_window(self, left: int, top: int, right: int, bottom: int) -> LatticeWindow:
        """Return the file's samples in a box, NaN beyond the file, as the kernels of mosaics read them.

        left, top: the box's first column and row in the file. right, bottom: the ends of both. The file is the only
        tile of the window, of rank 0; samples beyond it have the rank UNCOVERED, missing ones NO_DATA.
        """
        width, height = self._plan.file_size
        x0, y0, x1, y1 = max(left, 0), max(top, 0), min(right, width), min(bottom, height)
        values = np.full((bottom - top, right - left), np.nan)
        ranks = np.full(values.shape, UNCOVERED, np.int32)
        inside = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
        heights = self._read(y0, y1 - y0, x0, x1 - x0)
        values[inside], ranks[inside] = heights, np.where(np.isfinite(heights), 0, NO_DATA)
        rectangles = np.array([[0, 0, width - 1, height - 1]])
        return LatticeWindow(values, ranks, left, top, rectangles, tile_ranks=np.array([0]))

    def _find_nodes(self, column: int, row: int) -> BlockNodes:
        """Return the positions of a block's samples in the file, at nodes. column, row: number of the block.

        Nodes have the widest of SPACINGS for which interpolated positions are off by TOLERANCE at most. They end at the
        grid's border, because positions beyond are of no use and may not exist.
        """
        if self._plan.source.crs == self._plan.target.crs:  # linear, so any spacing is exact
            u, v = self._exact(column, row, SPACINGS[0], SPACINGS[0])
            return BlockNodes(u, v, SPACINGS[0], SNAPPED, SNAPPED)
        for spacing in SPACINGS:
            exact = self._exact(column, row, spacing // 2, spacing)  # at nodes, and halfway to measure the errors
            errors = [interpolation_error(values) for values in exact]
            if max(errors) <= TOLERANCE and np.isfinite(exact).all():
                u, v = (np.ascontiguousarray(values[::2, ::2]) for values in exact)
                # Elsewhere in a cell errors may be larger by MARGIN, and a position snaps to a sample within SNAPPED.
                return BlockNodes(u, v, spacing, MARGIN * errors[0] + SNAPPED, MARGIN * errors[1] + SNAPPED)
        # The last spacing has computed every sample.
        return BlockNodes(exact[0], exact[1], spacing=1, error_u=SNAPPED, error_v=SNAPPED)

    def _exact(self, column: int, row: int, step: int, spacing: int) -> np.ndarray:
        """Return exact columns and rows of the file at every `step` samples of a block: float64 [2, rows, columns].

        A block at the grid's border ends at the first node on or beyond that border. column, row: number of the block.
        spacing: samples between nodes.
        """
        source, target, file_size, size = self._plan  # grids of the file and of the result, and their columns and rows
        samples = []  # numbers of the block's columns and rows in the grid
        for number, count in zip((column, row), size, strict=True):
            cells = min(BLOCK, -(-(count - number * BLOCK) // spacing) * spacing)
            samples.append(number * BLOCK + np.arange(0.0, cells + 1.0, step))
        columns, rows = np.meshgrid(*samples)
        x, y = target.positions(columns + 0.5, rows + 0.5)  # samples are in the middle of cells
        if source.crs != target.crs:
            found = find_positions(target.crs, source.crs, x.ravel(), y.ravel())
            x, y = (values.reshape(columns.shape) for values in found)
        a, b, c, d, e, f = source.placed
        with np.errstate(invalid="ignore"):
            if degrees := unit_of(source.crs).get("degrees"):  # the turn of 360 degrees that is nearest to the file
                middle = float(source.positions(*(count / 2 for count in file_size))[0])
                x -= 360.0 / degrees * np.round((x - middle) * degrees / 360.0)
            area = a * e - b * d  # by which the inverse of the transform divides
            return np.stack([(e * (x - c) - b * (y - f)) / area, (a * (y - f) - d * (x - c)) / area]) - 0.5
