# SPDX-License-Identifier: GPL-3.0-or-later
"""Insets: finer tiles on coarser ones. Within a ring inside their border, their heights blend to those below.

Lattices of about the same step form a level, and each level is laid on those with larger steps. A seam of a level is a
sample that it lacks and that is known below. Distances to seams are measured between the corners of square cells at
fixed places of the grid, so a blended height depends on its place and the tiles alone.

Marks are bits of a level's samples: bit n for a seam where level n shows, the last bit for a sample with nothing below.

A rank is a tile's number in the order of priority; it is negative for a sample without a value. A block is a square of
BLOCK x BLOCK samples of the grid, at a fixed place.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..rasters.grid_pieces import BLOCK, GridPiece, PieceValues
from .lattices import TileLattice
from .seam_records import SeamRecords
from .target_grid import TargetGrid

RING = 32  # samples of the coarser tiles between the border of an inset and its own heights
MIN_RATIO = 1.9  # of the steps of two levels
MIN_SIDE = 8  # samples of the level below; a narrower lattice is not blended, because a ring would leave nothing of it
# A ring is at most 1 / this of the largest distance to a seam, so most of an inset keeps its heights.
MAX_PART = 4
WIDER = 4  # ring cells along a side of the larger cells by which that distance is measured
MAX_LEVELS = 62  # whose seams are bits of one number
MAX_STRETCH = 4.0  # of a ring's axes
MAX_CELL_BYTES = 1 << 28  # cached marks
INSIDE = 1e-6  # samples

Scan = Callable[[int, int], Iterator[tuple[GridPiece, int, PieceValues, PieceValues]]]


class BlendRing(NamedTuple):
    """The ring of insets on tiles of one level.

    Attributes:
        cell: samples of the grid along a side of the cells by which distances are measured; a power of 2.
        width: its width in cells, down and across.
    """

    cell: int
    width: tuple[float, float]

    @property
    def reach(self) -> tuple[int, int]:
        """Return the width in whole cells, down and across."""
        return int(np.ceil(self.width[0])), int(np.ceil(self.width[1]))


def overlapping_pairs(boxes: np.ndarray) -> list[tuple[int, int]]:
    """Return the pairs of ranks of tiles whose boxes overlap or touch, each with the lower one first, sorted.

    boxes: lowest x and y, highest x and y of each tile by rank, float64 [n, 4], in samples of the grid.
    """
    order = np.argsort(boxes[:, 0], kind="stable")
    starts, pairs = boxes[order, 0], []
    for position, rank in enumerate(order):
        # tiles that begin further east, but not beyond this one
        end = int(np.searchsorted(starts, boxes[rank, 2] + INSIDE, side="right"))
        others = order[position + 1 : end]
        meets = (boxes[others, 1] <= boxes[rank, 3] + INSIDE) & (boxes[others, 3] >= boxes[rank, 1] - INSIDE)
        pairs += [(min(rank, other), max(rank, other)) for other in others[meets]]
    return sorted((int(lower), int(upper)) for lower, upper in pairs)


def find_levels(lattices: Sequence[TileLattice], steps: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the level of each tile, 0 for the coarsest, and 0 for all if no tile overlaps a coarser one.

    steps: float64 [tiles, 2], samples of the grid between samples of a tile. boxes: float64 [tiles, 4], lowest column
    and row of the grid and highest ones of each tile. lattices: of all tiles.
    """
    levels, sizes = np.zeros(len(steps), np.int64), np.sqrt(steps[:, 0] * steps[:, 1])  # sizes: mean step of each tile
    coarsest = np.array([sizes[lattice.tiles].max() for lattice in lattices])
    level, first_size, owners = 0, coarsest.max(), np.zeros(len(steps), np.int64)  # owners: the lattice of each tile
    # From the coarsest lattice on: one that is MIN_RATIO finer than the first of its level begins the next level.
    for number in np.argsort(-coarsest, kind="stable"):
        if coarsest[number] * MIN_RATIO <= first_size and level < MAX_LEVELS - 1:
            level, first_size = level + 1, coarsest[number]
        levels[lattices[number].tiles], owners[lattices[number].tiles] = level, number
    if level == 0:
        return levels
    pairs = np.array(overlapping_pairs(boxes), np.int64).reshape(-1, 2)
    lower, upper = pairs[levels[pairs[:, 0]] < levels[pairs[:, 1]]].T  # finer tiles over coarser ones
    finest_below = np.full(len(lattices), -1)  # finest level below each lattice, -1 for none
    np.maximum.at(finest_below, owners[upper], levels[lower])
    level_steps = [steps[levels == number].max(axis=0) for number in range(level + 1)]
    # A lattice narrower than MIN_SIDE samples of the level below has no room for a ring, and joins that level.
    for number in np.flatnonzero(finest_below >= 0):
        tiles, below = lattices[number].tiles, finest_below[number]
        sides = boxes[tiles, 2:].max(axis=0) - boxes[tiles, :2].min(axis=0)
        if (sides < MIN_SIDE * level_steps[below]).any():
            levels[tiles] = below
    lower, upper = levels[pairs].T  # the final levels of each overlapping pair, of which `upper` may be the finer
    # np.unique numbers the remaining levels without gaps.
    return np.unique(levels, return_inverse=True)[1] if (upper > lower).any() else np.zeros_like(levels)


class InsetBlend:
    """Blending of the levels of a mosaic.

    Attributes:
        levels: level of each tile.
        rings: ring of insets on each level.
        records: records of the marks of blocks, None for none.
    """

    def __init__(self, levels: np.ndarray, steps: np.ndarray, grid: TargetGrid, scan: Scan) -> None:
        """Prepare the rings of all levels.

        levels: of each tile, int [tiles]; level 0 is the coarsest. steps: float64 [tiles, 2], grid samples a sample of
        the tile. scan(row, column): yields for each part and level of a block the part, the level, and the values
        without this level and with it.
        """
        self.levels, self._scan = levels, scan
        self.rings = [_ring(steps[levels == level].max(axis=0, initial=0.0)) for level in range(levels.max() + 1)]
        self._kind = np.min_scalar_type(1 << len(self.rings))  # of `_marks`: a bit for each level and one more
        # By rank, so the last two are for UNCOVERED (-1) and NO_DATA (-2).
        self._bits = np.append(np.left_shift(1, levels), [0, 0]).astype(self._kind)
        last = grid.row + grid.height - 1, grid.column + grid.width - 1
        # First and last row, and first and last column, of the grid's blocks.
        self._block_ranges = (grid.row // BLOCK, last[0] // BLOCK), (grid.column // BLOCK, last[1] // BLOCK)
        # Marks of blocks by (row, column) and level, the block used last at the end, and the bytes of all.
        self._cells: OrderedDict[tuple[int, int], dict[int, np.ndarray]] = OrderedDict()
        self._bytes = 0
        self._digests: dict[tuple[int, int], bytes] = {}
        self.records: SeamRecords | None = None

    @property
    def reach(self) -> int:
        """Return the distance, samples of the grid, up to which tiles influence a blended sample.

        It is the margin of the widest window of `_marks_around`, whose first and last cells are whole.
        """
        wide = map(_widened, self.rings)
        # Each ring of a window, and how many of its widths the margin has.
        windows = [*((ring, 1) for ring in self.rings), *((ring, MAX_PART + 1) for ring in wide)]
        # Two cells more: the margin's additional one, and that in which the sample is.
        return max(ring.cell * (rings * max(ring.reach) + 2) for ring, rings in windows)

    def blend(self, level: int, piece: GridPiece, below: PieceValues, top: PieceValues) -> None:
        """Blend the values of a level in `top` to those below it, in place, where both are known and inside a ring.

        below, top: values, ranks and position errors (`moved`) of the piece's samples without the level, and with it.
        Position errors are blended as the values.
        """
        mixed = (below.ranks >= 0) & (top.ranks > below.ranks)
        if not mixed.any():
            return
        fraction = np.ones(mixed.shape)  # of the way through a ring, the smallest of the rings on all levels below
        for lower in range(level):
            of_ring = self._fractions(level, lower, piece)
            fraction = fraction if of_ring is None else np.minimum(fraction, of_ring)
        mixed &= fraction < 1.0
        t = fraction[mixed]
        weight = t * t * (3.0 - 2.0 * t)  # from 0 to 1 without a kink at either end
        for of_top, of_below in ((top.values, below.values), (top.moved, below.moved)):
            of_top[mixed] = of_below[mixed] * (1.0 - weight) + of_top[mixed] * weight

    def _fractions(self, level: int, lower: int, piece: GridPiece) -> np.ndarray | None:
        """Return how far samples are on their way through the ring, 0 at seams to 1 inside; None for 1 everywhere.

        It is the ring of `level` on tiles of the level `lower`. The result is float64 [rows, columns] of the piece.
        """
        ring = self.rings[lower]
        marks = self._marks_around(level, ring, piece, margin_rings=1)
        # Bit `lower` marks seams on that level, the last bit samples of the inset without tiles below (`_marks`).
        seams, ends = marks >> lower & 1 != 0, marks >> len(self.rings) & 1 != 0
        if not seams.any():
            return None
        # In a narrow inset the ring is narrower: it depends on the largest distance to a seam nearby, which is measured
        # in the larger cells of the widened ring, because it looks further.
        wide = _widened(ring)
        cells_per_wide = wide.cell // ring.cell
        widest = find_widest(self._marks_around(level, wide, piece, margin_rings=MAX_PART + 1) >> lower & 1 != 0, wide)
        # Corners of the ring's cells that the piece meets, down and across: their numbers from the grid's origin.
        first = piece.row // ring.cell, piece.column // ring.cell
        last = (piece.row + piece.rows - 1) // ring.cell, (piece.column + piece.columns - 1) // ring.cell
        corners = [np.arange(n, m + 2) for n, m in zip(first, last, strict=True)]
        # Interpolate from corners of the wide ring's cells, the first of which is not after n[0], to these corners.
        widest = _interpolate(widest, *(n / cells_per_wide - n[0] // cells_per_wide for n in corners))
        nodes = ring_fractions(seams, ends, widest, ring)
        # Interpolate from these corners to the samples, which are in the middle of squares of side 1.
        rows, columns = piece.row + np.arange(piece.rows), piece.column + np.arange(piece.columns)
        positions = ((n + 0.5) / ring.cell - start for n, start in zip((rows, columns), first, strict=True))
        return _interpolate(nodes, *positions)

    def _marks_around(self, level: int, ring: BlendRing, piece: GridPiece, margin_rings: int) -> np.ndarray:
        """Return the marks (`_marks`) of a level in a ring's cells that a piece meets, united over each cell's samples.

        The window has a margin of `margin_rings` widths of the ring and one cell.
        """
        # Cells along a block, and of the margin, down and across.
        size, margin = BLOCK // ring.cell, [margin_rings * reach + 1 for reach in ring.reach]
        # First and last cell of the window, rows and columns of cells from the grid's origin.
        first = piece.row // ring.cell - margin[0], piece.column // ring.cell - margin[1]
        last = piece.row + piece.rows - 1, piece.column + piece.columns - 1
        last = last[0] // ring.cell + margin[0], last[1] // ring.cell + margin[1]
        cells = np.zeros((last[0] - first[0] + 1, last[1] - first[1] + 1), self._kind)
        for row, column in self._blocks(*((n // size, m // size) for n, m in zip(first, last, strict=True))):
            block_marks = self._marks_of_block(row, column).get(level)
            if block_marks is None:
                continue
            pooled = _pool(block_marks, len(block_marks) // size)  # stored cells are those of the finest ring
            # the block's first cell, counted in the window; it is negative if the block begins outside
            top, left = row * size - first[0], column * size - first[1]
            window = cells[max(top, 0) : top + size, max(left, 0) : left + size]
            window[:] = pooled[max(-top, 0) :, max(-left, 0) :][: window.shape[0], : window.shape[1]]
        return cells

    def _marks_of_block(self, row: int, column: int) -> dict[int, np.ndarray]:
        """Return the marks of a block's cells by level, from the cache, its record or the files.

        They are united over the samples of each cell. Levels without a mark in the block are left out. row, column:
        number of the block.
        """
        key = row, column
        if key not in self._cells:
            known = None
            if self.records is not None:
                known = self.records.find(key, self._kind, self._side_of)
            self._cells[key] = self._find_marks(row, column) if known is None else known
            if known is None and self.records is not None:
                self.records.note(key, self._cells[key])
            self._bytes += sum(marks.nbytes for marks in self._cells[key].values())
            while self._bytes > MAX_CELL_BYTES and len(self._cells) > 1:
                self._bytes -= sum(marks.nbytes for marks in self._cells.popitem(last=False)[1].values())
        self._cells.move_to_end(key)
        return self._cells[key]

    def _blocks(self, *spans: tuple[int, int]) -> Iterator[tuple[int, int]]:
        """Return row and column of each of the grid's blocks between the first and last row, and column, of blocks."""
        ends = zip(spans, self._block_ranges, strict=True)
        rows, columns = (range(max(first, low), min(last, high) + 1) for (first, last), (low, high) in ends)
        return product(rows, columns)

    def _side_of(self, level: int) -> int:
        """Return the number of cells along a block for the marks of a level, of the finest ring on lower levels."""
        return BLOCK // min(ring.cell for ring in self.rings[:level])

    def _find_marks(self, row: int, column: int) -> dict[int, np.ndarray]:
        """Read the files of the block (row, column), and return the marks of its cells by level, without empty ones."""
        by_level: dict[int, np.ndarray] = {}
        for piece, level, below, top in self._scan(row, column):
            marks = by_level.setdefault(level, np.zeros((BLOCK, BLOCK), self._kind))
            y, x = piece.row % BLOCK, piece.column % BLOCK
            marks[y : y + piece.rows, x : x + piece.columns] = self._marks(below.ranks, top.ranks)
        # Unite the marks of samples in cells, of which a block has _side_of(level) along a side.
        pooled = {level: _pool(marks, BLOCK // self._side_of(level)) for level, marks in by_level.items()}
        return {level: marks for level, marks in pooled.items() if marks.any()}

    def digest_around(self, piece: GridPiece) -> str:
        """Return a hex digest of all marks that may change the blend in a piece; blocks are read if need be."""
        reach, content = self.reach, hashlib.blake2b(digest_size=16)
        spans = (piece.row, piece.rows), (piece.column, piece.columns)
        for key in self._blocks(*(((n - reach) // BLOCK, (n + count - 1 + reach) // BLOCK) for n, count in spans)):
            if key not in self._digests:
                marks = self._marks_of_block(*key)
                block = hashlib.blake2b(repr((key, sorted(marks))).encode(), digest_size=16)
                for level in sorted(marks):
                    block.update(marks[level].tobytes())
                # Nothing without marks, as of blocks beyond the mosaic, so that its extent does not count.
                self._digests[key] = block.digest() if marks else b""
            content.update(self._digests[key])
        return content.hexdigest()

    def _marks(self, below: np.ndarray, top: np.ndarray) -> np.ndarray:
        """Return marks of samples: bit n where this level has no value and level n shows, else 0 or the last bit.

        The last bit is set where only this level has a value. below, top: ranks of the samples without this level and
        with it.
        """
        marks = self._bits[below]  # the bit of the tile's level; 0 for the negative ranks, by the last two entries
        marks[top != below] = 0  # this level has a value there
        marks[(below < 0) & (top >= 0)] = 1 << len(self.rings)
        return marks


def _ring(steps: np.ndarray) -> BlendRing:
    """Return the ring of insets on tiles with these steps, samples of the grid along x and y.

    It is RING steps wide. Its cell is a power of two, so that whole cells fill a block, and at most the shorter step.
    Its axes differ by a factor of MAX_STRETCH at most, which limits the number of cells across it.
    """
    shortest = min(float(steps.min()), float(BLOCK))
    across, down = (min(float(step), MAX_STRETCH * shortest) for step in steps)
    cell = 1
    while 2 * cell <= shortest:
        cell *= 2
    return BlendRing(cell, width=(RING * down / cell, RING * across / cell))  # in cells


def _widened(ring: BlendRing) -> BlendRing:
    """Return a ring with cells up to WIDER times as wide, in which distances over several rings are cheap."""
    times = min(WIDER, BLOCK // ring.cell)
    return BlendRing(times * ring.cell, (ring.width[0] / times, ring.width[1] / times))


def _pool(marks: np.ndarray, side: int) -> np.ndarray:
    """Return the marks of squares of side x side samples: all bits that a sample of the square has."""
    if side == 1:
        return marks
    rows = np.bitwise_or.reduce(marks.reshape(len(marks) // side, side, -1), axis=1)
    return np.bitwise_or.reduce(rows.reshape(len(rows), -1, side), axis=2)


def _interpolate(nodes: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return values between nodes, bilinearly, float64 [len(down), len(across)].

    down, across: rows and columns in units of nodes; every row is combined with every column.
    """
    j, i = down.astype(np.int64), across.astype(np.int64)
    t, s = (down - j)[:, None], across - i
    rows = nodes[j] * (1.0 - t) + nodes[np.minimum(j + 1, nodes.shape[0] - 1)] * t
    return rows[:, i] * (1.0 - s) + rows[:, np.minimum(i + 1, nodes.shape[1] - 1)] * s


def find_widest(seams: np.ndarray, ring: BlendRing) -> np.ndarray:
    """Return for each corner of cells the largest distance to a seam among all corners up to one ring's width away.

    It tells how wide the inset is there. It is in widths of the ring, at most MAX_PART. seams: bool, cells with a seam,
    with a margin of MAX_PART + 1 rings and one cell, for which there is no result.
    """
    down, across = ring.reach
    near = _distances(_corners(seams), ring, limit=MAX_PART)
    near = near[MAX_PART * down : -MAX_PART * down, MAX_PART * across : -MAX_PART * across]  # those that are complete
    widest = sliding_window_view(near, 2 * down + 1, axis=0).max(axis=-1)
    return sliding_window_view(widest, 2 * across + 1, axis=1).max(axis=-1)


def ring_fractions(seams: np.ndarray, ends: np.ndarray, widest: np.ndarray, ring: BlendRing) -> np.ndarray:
    """Return how far the corners of cells are on their way through a ring, 0 to 1.

    The ring is narrower where the inset is, and where the tiles below end under it, so that there is no step.

    Args:
        seams: bool, cells with a seam, with a margin of one ring and one cell.
        ends: bool, cells with a sample of the inset that has nothing below, with the same margin.
        widest: float64, distances of `find_widest` at the corners, in widths of the ring.
        ring: the ring at its full width.
    """
    down, across = ring.reach
    marks = _corners(seams), _corners(ends)
    # Distances to a seam and to the end of the tiles below, in widths of the ring. The ring is never wider than their
    # sum, so the fraction near / width rises to 1 where `beyond` is 0, and no step is there.
    near, beyond = (_distances(marked, ring, limit=1)[down:-down, across:-across] for marked in marks)
    # It also takes at most one part in MAX_PART of the inset's half width `widest`.
    width = np.minimum(np.minimum(widest / MAX_PART, near + beyond), 1.0)
    return np.minimum(np.divide(near, width, out=np.zeros_like(near), where=width > 0.0), 1.0)


def _corners(cells: np.ndarray) -> np.ndarray:
    """Return which corners between 2 x 2 cells touch a marked cell: bool, one row and one column fewer than cells."""
    rows = cells[:-1] | cells[1:]
    return rows[:, :-1] | rows[:, 1:]


def _distances(marked: np.ndarray, ring: BlendRing, limit: int) -> np.ndarray:
    """Return the distance of corners to the nearest `marked` one, in widths of the ring; at most `limit` widths."""
    # First along each row, then over rows: the squared distance is the sum of both. 2^30 columns away: none is marked.
    columns, far = np.arange(marked.shape[1]), float(limit * limit)
    before = np.maximum.accumulate(np.where(marked, columns, -(1 << 30)), axis=1)
    after = np.minimum.accumulate(np.where(marked, columns, 1 << 30)[:, ::-1], axis=1)[:, ::-1]
    along = np.minimum(columns - before, after - columns) / ring.width[1]
    squares = np.minimum(along * along, far)
    nearest = squares.copy()
    # A mark in another row, up to `limit` widths above or below, may be nearer.
    for row in range(1, min(int(np.ceil(limit * ring.width[0])), len(marked) - 1) + 1):
        down = row / ring.width[0]
        np.minimum(nearest[row:], squares[:-row] + down * down, out=nearest[row:])
        np.minimum(nearest[:-row], squares[row:] + down * down, out=nearest[:-row])
    return np.sqrt(nearest)
