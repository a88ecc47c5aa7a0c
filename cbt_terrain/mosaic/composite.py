# SPDX-License-Identifier: GPL-3.0-or-later
"""The composite of a mosaic: heights of any window of its grid, a pure function of the tiles, the grid and the window.

A sample is interpolated in the lattice of its sources. Where several lattices have a value, the tile of the highest
rank decides. Samples in the cell between two tiles without a common lattice are interpolated between their borders.
Finer tiles on coarser ones blend to them at their borders (insets.py).
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..formats.archives import UnpackedFiles
from ..formats.gdal_source import open_overview
from ..importing.source_list import file_stat
from ..rasters.grid_pieces import (
    BLOCK,
    MAX_BUFFER,
    NO_DATA,
    SNAPPED,
    UNCOVERED,
    BlockNodes,
    GridPiece,
    LatticeWindow,
    PieceValues,
    empty_values,
    pieces_of,
)
from ..rasters.raster import ImportSettings, Raster
from .bridges import bridge
from .catalogue import SourceTile, open_tile
from .datums import find_shifts
from .finer_plan import FinerPlan
from .insets import InsetBlend, find_levels
from .lattices import TileLattice, find_lattices
from .positions import is_congruent, nodes_of
from .seam_records import SeamRecords
from .target_grid import Footprints, TargetGrid, rank_tiles
from .windows import FoundLattice, at_corners, resample_levels, source_box, turns_around

MAX_OPEN = 256  # files
MAX_BLOCKS = 4096  # whose nodes are kept, 17 KB each
METHOD = 1  # increased when the same files give other values


class Composite:
    """Tiles on a grid, read by windows.

    Attributes:
        grid: the target grid.
        tiles, lattices: tiles in ascending order of priority, which is their rank, and their lattices.
        stored: type of the samples; float64 if any are interpolated or converted.
        scale, offset: a height is value * scale + offset metres.
        resamples: whether samples of some files are interpolated.
        shifts: conversion of heights to one vertical datum, None for none.
        insets: the blending of finer tiles on coarser ones; None without any, or if the settings leave it out.
        on_piece: is called before each piece that is read, because reading many files may take long.
        boxes: float64 [tiles, 4], lowest column and row of the grid and highest ones of each tile's outer samples.
        reach: float64 [tiles, 2], columns and rows of the grid beyond its box that a tile may have a part in.
        near: float64 [tiles, 4], boxes with their reach.
        steps: float64 [tiles], samples of the grid between two of a tile.
        step_levels: int64 [tiles], 0 for the coarsest tiles; finer ones on top of them have higher numbers.
        levels: `step_levels`, or 0 for all tiles if the settings leave the blending out.
        finer: the plan and the composite of finer tiles, None for one step everywhere.
        finest: the plan of finer tiles that a composite with one step leaves out, None without one.
        notes: sentences for the report.
        reads_overviews: whether overviews of files were read for a quick import.
    """

    def __init__(
        self,
        tiles: Sequence[SourceTile],
        grid: TargetGrid,
        footprints: Footprints,
        settings: ImportSettings,
        unpacked: UnpackedFiles,
    ) -> None:
        """Prepare the tiles; footprints: in the grid's system. unpacked: height maps of archives. No file is opened."""
        order = rank_tiles(tiles, footprints, settings)  # from now on a tile's number is its rank
        self.grid, self._settings, self._unpacked = grid, settings, unpacked
        self.on_piece: Callable[[], None] = lambda: None
        self.reads_overviews = False
        self.notes: list[str] = []
        self.finer: tuple[FinerPlan, Composite] | None = None
        self.finest: FinerPlan | None = None
        self.tiles = [tiles[n] for n in order]
        self.lattices = find_lattices(self.tiles)
        # A bridge needs a reach of one step; the rest is a margin, since boxes are of some points of a border.
        boxes, steps = footprints.boxes[order], footprints.steps[order] / (grid.step_x, grid.step_y)
        low_u, high_v = grid.indices(boxes[:, 0], boxes[:, 1])
        high_u, low_v = grid.indices(boxes[:, 2], boxes[:, 3])
        self.boxes = np.stack([low_u, low_v, high_u, high_v], axis=1)
        self.steps, self.reach = steps.max(axis=1), 2.0 * steps + 1.0
        self.near = self.boxes + np.concatenate([-self.reach, self.reach], axis=1)
        self.step_levels = find_levels(self.lattices, steps, self.boxes)
        self.levels = self.step_levels if settings.blend else np.zeros(len(tiles), np.int64)
        self.insets = InsetBlend(self.levels, steps, grid, self._scan) if self.levels.any() else None
        scales = {(tile.scale, tile.offset) for tile in self.tiles}
        kinds = {tile.stored for tile in self.tiles}
        on_grid = all(lattice.crs == grid.crs and is_congruent(lattice, grid) for lattice in self.lattices)
        self.resamples = not on_grid or self.insets is not None
        self.shifts = find_shifts(tiles)
        self._converts = len(scales) > 1 or self.shifts is not None
        scale_offset: tuple[float, float] = (1.0, 0.0) if self._converts else next(iter(scales))
        self.scale, self.offset = scale_offset
        self.stored = next(iter(kinds)) if len(kinds) == 1 and not (self.resamples or self._converts) else "float64"
        self._open: OrderedDict[int, Raster] = OrderedDict()  # files by rank, those read last at the end
        self._nodes: OrderedDict[tuple, BlockNodes] = OrderedDict()  # by lattice, column and row of a block

    def read(self, row: int, rows: int, column: int = 0, columns: int | None = None) -> tuple[np.ndarray, float]:
        """Return a window, float64 [rows, columns] with NaN for gaps, and its largest error by an inexact position.

        The error has the unit of the values. row, column: first sample, counted from the grid's corner in the
        north-west. columns: None for all from there.
        """
        columns = self.grid.width - column if columns is None else columns
        values = np.full((rows, columns), np.nan)
        largest_error = 0.0
        for piece in pieces_of(self.grid.column + column, self.grid.row + row, columns, rows):
            top, left = piece.row - self.grid.row - row, piece.column - self.grid.column - column
            part = values[top : top + piece.rows, left : left + piece.columns]
            largest_error = max(largest_error, self._fill(piece, part))
        return values, largest_error

    def inputs_of(self, row: int, rows: int, column: int, columns: int) -> str:
        """Return a hex digest of everything that determines the values of a window of the grid.

        row, rows, column, columns: first row and column of the window, and numbers of them. No file is read. So the
        digest changes with every file that is near enough to change the blending of a finer file's border in the
        window.
        """
        reach = self.insets.reach if self.insets is not None else 0
        return self._inputs(GridPiece(self.grid.column + column, self.grid.row + row, columns, rows), reach)

    def inputs_by_seams(self, row: int, rows: int, column: int, columns: int) -> str:
        """Return a digest of everything that determines the values of a window: its files, and the seams around it.

        A seam is the border between a finer and a coarser file, where both are blended. `inputs_of` reads no file, so
        it takes all files near the window instead; this digest reads seams without a record, and changes less often.
        """
        piece = GridPiece(self.grid.column + column, self.grid.row + row, columns, rows)
        seams = self.insets.digest_around(piece) if self.insets is not None else ""
        return f"{self._inputs(piece, reach=0)} {seams}"

    def keep_seams(self, find: Callable[[int, int], dict | None], note: Callable[..., None]) -> None:
        """Let the blending take seams (borders between finer and coarser files) from records of an earlier import.

        The seams of blocks without a valid record are found by reading files, and recorded. find(row, column): returns
        the values of the record of a block of the grid, None for none. note(row, column, **values): writes one. Rows
        and columns of blocks are counted from the grid's origin (x0, y0).
        """
        if self.insets is None:
            return

        def inputs_at(row: int, column: int) -> str:
            """Return a digest of all that determines the seams of a block."""
            return self._inputs(GridPiece(column * BLOCK, row * BLOCK, BLOCK, BLOCK), reach=0)

        self.insets.records = SeamRecords(find, note, inputs_at)

    def _inputs(self, piece: GridPiece, reach: int) -> str:
        """Return a digest of all that determines the values of a piece, with the files up to `reach` samples away."""
        column, row, columns, rows = piece.column, piece.row, piece.columns, piece.rows
        meets = self._meets(GridPiece(column - reach, row - reach, columns + 2 * reach, rows + 2 * reach))
        # grid[:5]: its system, origin and steps. Its extent does not change a sample's value.
        parts: list = [METHOD, self.grid[:5], column, row, columns, rows, self.stored, self.scale, self.offset]
        parts += [self._settings.band, str(self._settings.no_data), self._settings.encoding]
        for lattice in self.lattices:
            if meets[lattice.tiles].any():
                parts.append((lattice.crs, lattice.origin, lattice.steps, lattice.off_grid, lattice.period))
                # The middle of a lattice decides which turn of 360 degrees its longitudes are of.
                parts += [lattice.rectangles.mean(axis=0).tolist()] if lattice.period else []
        if self.insets is not None:
            parts += [self.insets.rings, self.levels[meets].tolist()]
        tiles = [self.tiles[rank] for rank in np.flatnonzero(meets)]  # in the order of their priority
        if self.shifts is not None:
            parts += [self.shifts.reference.datum, *map(file_stat, self.shifts.grids([self.shifts.reference, *tiles]))]
        parts += tiles
        return hashlib.blake2b(repr(parts).encode(), digest_size=16).hexdigest()

    def shift_error(self, row: int, rows: int, column: int, columns: int) -> float:
        """Return the largest error, metres, of shifts between vertical datums of the tiles that a window may meet."""
        if self.shifts is None:
            return 0.0
        meets = self._meets(GridPiece(self.grid.column + column, self.grid.row + row, columns, rows))
        return max((self.shifts.error_of(self.tiles[rank]) for rank in np.flatnonzero(meets)), default=0.0)

    def all_roundings(self) -> tuple:
        """Return the different roundings of the files, in the unit of the composite's values; metres if it converts."""
        return tuple(
            dict.fromkeys(
                rounding.scaled(tile.scale, tile.offset) if self._converts else rounding
                for tile in self.tiles
                for rounding in tile.roundings
            )
        )

    def close(self) -> None:
        """Close all files."""
        if self.finer is not None:
            self.finer[1].close()  # the composite of all files
        while self._open:
            self._open.popitem()[1].close()

    def _meets(self, piece: GridPiece) -> np.ndarray:
        """Return which tiles may have a part in a piece: bool [tiles]."""
        low, high = self.near[:, :2], self.near[:, 2:]
        first = piece.column, piece.row
        return ((low < (piece.column + piece.columns, piece.row + piece.rows)) & (high >= first)).all(axis=1)

    def _parts(self, piece: GridPiece) -> Iterator[tuple[GridPiece, np.ndarray, list[FoundLattice]]]:
        """Yield a piece, or its parts if it needs too many source samples at once, with the source samples read for it.

        Each part comes with the levels of the tiles near it, ascending (level 0 has the coarsest tiles), and with a
        FoundLattice, which holds the samples, for each lattice (a grid that several tiles share) with tiles near it.
        """
        self.on_piece()
        meets, found = self._meets(piece), []
        for number, lattice in enumerate(self.lattices):
            near = np.flatnonzero(meets[lattice.tiles])
            if not len(near):
                continue
            nodes = self._nodes_of(number, *piece.block)  # positions in the lattice, of every 32nd sample of the block
            box = source_box(lattice, near, nodes, piece)
            if box is None:
                continue
            if (box[2] - box[0]) * (box[3] - box[1]) > MAX_BUFFER and piece.columns * piece.rows > 1:
                for half in piece.halves():
                    yield from self._parts(half)
                return
            level = int(self.levels[lattice.tiles[0]])  # that of all its tiles
            found.append(FoundLattice(level, nodes, self._window(lattice, near, box)))
        yield piece, np.unique(self.levels[meets]), found

    def _fill(self, piece: GridPiece, values: np.ndarray) -> float:
        """Fill the values of a piece, all NaN, and return their largest error by an inexact position.

        Coarse tiles come first, and finer ones replace them, blended at their borders.
        """
        if self._copy(piece, values):
            return 0.0
        largest_error = 0.0
        for part, levels, found in self._parts(piece):
            result = empty_values(part)
            # Each step has written one more level over `result`; `below` is what stood there before.
            for level, below in resample_levels(part, levels, found, result):
                if below is not None and self.insets is not None:
                    self.insets.blend(level, part, below, result)
            if found and (result.ranks == UNCOVERED).any():
                # Also in place: *result are the values, their ranks and their position errors.
                bridge(part, [(lattice.nodes, lattice.window) for lattice in found], *result)
            top, left = part.row - piece.row, part.column - piece.column
            values[top : top + part.rows, left : left + part.columns] = result.values
            largest_error = max(largest_error, float(result.moved.max()))
        return largest_error

    def _copy(self, piece: GridPiece, values: np.ndarray) -> bool:
        """Fill a piece from one lattice whose samples are the grid's, and return whether its tiles cover the piece.

        If not, `values` are unchanged. Copied values are bit for bit those that an interpolation gives.
        """
        meets = self._meets(piece)
        numbers = [number for number, lattice in enumerate(self.lattices) if meets[lattice.tiles].any()]
        if len(numbers) != 1:
            return False
        lattice, nodes = self.lattices[numbers[0]], self._nodes_of(numbers[0], *piece.block)
        if nodes.spacing != BLOCK or nodes.error_u or nodes.error_v or lattice.period:
            # Positions in the lattice are not exactly linear between the corners of the piece's block.
            return False
        u, v = (at_corners(values_at_nodes, piece) for values_at_nodes in (nodes.u, nodes.v))
        left, top = round(u[0]), round(v[0])
        ends = left + piece.columns - 1, top + piece.rows - 1
        # Corner 0 is the first sample, 3 the last. Lattices with other steps or turned axes miss one of them.
        if max(abs(u[0] - left), abs(v[0] - top), abs(u[3] - ends[0]), abs(v[3] - ends[1])) >= SNAPPED:
            return False
        covered, parts = np.zeros(values.shape, bool), []  # parts: slices of `values`, rank of a tile, and its window
        for n in np.flatnonzero(meets[lattice.tiles]):  # ascending ranks, so that the highest is copied last
            x0, y0, x1, y1 = map(int, lattice.rectangles[n])
            west, north, east, south = max(x0, left), max(y0, top), min(x1, ends[0]) + 1, min(y1, ends[1]) + 1
            if west < east and north < south:
                inside = slice(north - top, south - top), slice(west - left, east - left)
                covered[inside] = True
                parts.append((inside, int(lattice.tiles[n]), (north - y0, south - north, west - x0, east - west)))
        if not covered.all():  # samples between two tiles are interpolated between their borders
            return False
        self.on_piece()
        for inside, rank, window in parts:
            heights = self.tile_window(rank, *window)
            np.copyto(values[inside], heights, where=np.isfinite(heights))
        return True

    def _scan(self, row: int, column: int) -> Iterator[tuple[GridPiece, int, PieceValues, PieceValues]]:
        """Yield the parts of a block with each level of finer tiles, the values below that level, and those with it.

        row, column: numbers of the block. The next step overwrites the values with the next level.
        """
        block = GridPiece(column * BLOCK, row * BLOCK, BLOCK, BLOCK)
        if self.levels[self._meets(block)].any():
            for part, levels, found in self._parts(block):
                result = empty_values(part)
                for level, below in resample_levels(part, levels, found, result):
                    if below is not None:
                        yield part, level, below, result

    def _nodes_of(self, number: int, column: int, row: int) -> BlockNodes:
        """Return the nodes of the block (column, row) for the lattice `number`, computed on first use.

        Nodes are samples of the block, such as every 32nd, whose positions in the lattice are exact; those of the
        samples between are interpolated.
        """
        key = number, column, row
        if key not in self._nodes:
            self._nodes[key] = nodes_of(self.lattices[number], self.grid, column, row)
            if len(self._nodes) > MAX_BLOCKS:
                self._nodes.popitem(last=False)
        self._nodes.move_to_end(key)
        return self._nodes[key]

    def _window(self, lattice: TileLattice, near: np.ndarray, box: tuple[int, int, int, int]) -> LatticeWindow:
        """Read a box of a lattice from some tiles, in the order of their ranks.

        near: indices of these tiles in `lattice.tiles`. box: first column and row, and their ends. The result lists the
        rectangles of all these tiles, also outside the box: a gap that is interpolated up to them may begin in it.
        """
        left, top, right, bottom = box
        values = np.full((bottom - top, right - left), np.nan)
        ranks = np.full(values.shape, UNCOVERED, np.int32)  # UNCOVERED and NO_DATA are negative, below all ranks
        used, used_ranks = [], []  # rectangles and ranks of the tiles; around the globe each has several places
        low, high = lattice.rectangles[near, 0].min(), lattice.rectangles[near, 2].max()
        turns = turns_around(low, high, left, right, lattice.period)
        for turn in range(-turns, turns + 1):
            for n in near:
                rectangle = lattice.rectangles[n] + (turn * lattice.period, 0, turn * lattice.period, 0)
                x0, y0 = max(rectangle[0], left), max(rectangle[1], top)
                x1, y1 = min(rectangle[2] + 1, right), min(rectangle[3] + 1, bottom)
                used.append(rectangle)
                used_ranks.append(lattice.tiles[n])
                if x0 >= x1 or y0 >= y1:
                    continue
                rank = int(lattice.tiles[n])
                window = y0 - rectangle[1], y1 - y0, x0 - rectangle[0], x1 - x0
                heights = self.tile_window(rank, *map(int, window))
                inside = slice(y0 - top, y1 - top), slice(x0 - left, x1 - left)
                known, before = np.isfinite(heights), ranks[inside]
                is_higher = known & (rank > before)
                values[inside][is_higher] = heights[is_higher]
                # Where a tile is, but none yet has a height, the rank becomes NO_DATA.
                ranks[inside] = np.where(is_higher, rank, np.where(known | (before >= 0), before, NO_DATA))
        return LatticeWindow(values, ranks, left, top, np.array(used), np.array(used_ranks))

    def tile_window(self, rank: int, row: int, rows: int, column: int, columns: int) -> np.ndarray:
        """Return a window of a tile as float64 values of the composite, NaN where missing."""
        return self.values_of(self.tiles[rank], self._raster(rank), row, rows, column, columns)

    def values_of(self, tile: SourceTile, raster: Raster, row: int, rows: int, column: int, columns: int) -> np.ndarray:
        """Return a window of a tile's raster, or of an overview of it, float64 in the unit of the composite's values.

        Missing ones are NaN. row, column: first sample of the window. rows, columns: its size.
        """
        assert raster.window is not None, "the catalogue has only tiles that are read by windows"
        heights = raster.window(row, rows, column, columns).astype(np.float64)
        if not self._converts:
            return heights
        counts, shifts = (raster.height, raster.width), self.shifts  # counts: smaller than the tile's for an overview
        shift = shifts.window(tile, counts, row, rows, column, columns) if shifts is not None else 0.0
        return heights * tile.scale + tile.offset + shift

    def overview_of(self, rank: int, max_factor: int) -> Raster | None:
        """Return the coarsest overview of a tile with one sample for 2, 4, 8 ... `max_factor` of its samples a side.

        None without such an overview. The caller closes it. Files in archives are read from their unpacked copies.
        Raises TerrainError if its file has changed.
        """
        tile = self.tiles[rank]
        tile.check_unchanged()
        if tile.format != "GTiff":
            return None
        file = self._unpacked.path_of(Path(tile.path))
        return open_overview(file, self._settings, tile.width, tile.stored, max_factor)

    def _raster(self, rank: int) -> Raster:
        """Return the raster of a tile, opened and kept open. Raises TerrainError if its file or header has changed."""
        if rank not in self._open:
            tile = self.tiles[rank]
            tile.check_unchanged()
            raster = open_tile(self._unpacked.path_of(Path(tile.path)), self._settings)
            try:
                tile.check_header(raster)
            except TerrainError:
                raster.close()
                raise
            self._open[rank] = raster
            if len(self._open) > MAX_OPEN:
                self._open.popitem(last=False)[1].close()
        self._open.move_to_end(rank)
        return self._open[rank]
