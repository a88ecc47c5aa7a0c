# SPDX-License-Identifier: GPL-3.0-or-later
"""Mosaics whose finest files cover little: a coarser grid for all the land, and finer tiles where these files are.

A cell of the coarse grid has 2^bits x 2^bits finer cells, those of the grid with the finest step. A finer tile has
SIDE x SIDE of these; bits are limited (MAX_BITS), because no coarse cell may be larger than a tile.

The coarse grid has the step of the coarser files below the finest ones. A mosaic with wide gaps may have no such files.
Then all files count as finest ones, and the coarse grid has some of their samples.
"""

from dataclasses import dataclass

import numpy as np

from ..field.finer_tiles import MAX_BITS, SIDE
from .target_grid import TargetGrid

FEWEST = 1 << 29  # samples of a grid with the finest step; fewer are imported with one step in some minutes
SAVING = 4  # at least this many times fewer samples
FINER_COST = 4  # time of a finer sample, as a multiple of that of another: 1.6 us of the processor beside 0.4
MAX_TABLE = 1 << 28  # finer tiles of the whole grid, which a table numbers: 2^22 finest samples along both sides
# Of a mosaic with wide gaps. Where no file is, a sample takes only 0.1 us, so a plan must save more samples.
SAVING_OF_GAPS = 8
BITS_OF_GAPS = 4  # log2 of the finest samples along a coarse cell, at least
FEWEST_WITH_HOLES = 1 << 33  # samples of a grid whose gaps are cut out at cells of the coarse grid
MANY_OF_GAPS = 1 << 26  # samples; a coarse grid has fewer, since most are in gaps: they would fill 350 MB


@dataclass(frozen=True, eq=False)
class FinerPlan:
    """The division of a mosaic.

    Attributes:
        grid: of every 2^bits-th column and row of the finest grid.
        bits: log2 of the finest samples along a cell of that grid.
        is_of_gaps: whether all files count as finest ones.
        boxes: int64 [files, 4], first column and row and last ones of each finer file in the finest grid.
        tiles: number of finer tiles, with those around the files.
    """

    grid: TargetGrid
    bits: int
    is_of_gaps: bool
    boxes: np.ndarray
    tiles: int

    @property
    def work(self) -> int:
        """Return the number of samples of a raster without finer tiles whose import takes as long."""
        return self.grid.width * self.grid.height + FINER_COST * self.tiles * SIDE * SIDE


def plan_finer(
    grid: TargetGrid, levels: np.ndarray, steps: np.ndarray, boxes: np.ndarray, holes: bool
) -> FinerPlan | None:
    """Return how to divide a mosaic into a coarse raster and tiles of finer files; None if that saves little space.

    None also if the grid has fewer samples than FEWEST or more tiles than MAX_TABLE, and for a strip of fewer than 3
    coarse samples across.

    Args:
        grid: with the finest step.
        levels: of each file: 0 for the coarsest, more for finer ones on top of them.
        steps: samples of the grid between two of each file.
        boxes: [files, 4], lowest column and row of the grid and highest ones of each file.
        holes: whether gaps are cut out. Holes consist of whole cells, so a smaller mosaic with wide gaps has the finest
            step everywhere.
    """
    if not FEWEST <= grid.width * grid.height <= MAX_TABLE * SIDE * SIDE:
        return None
    is_finer, plan = levels > 0, None
    if is_finer.any():
        # The coarse step is the largest power of two of finer steps that does not exceed that of a coarse file.
        bits = min(int(np.log2(max(float(steps[~is_finer].min()), 1.0))), MAX_BITS)
        plan = _divide(grid, boxes, is_finer, bits, SAVING)
    if plan is None and (not holes or grid.width * grid.height >= FEWEST_WITH_HOLES):
        # There are no coarser files, or their steps are too fine to save much. All files count as finest ones.
        # A coarse cell is not larger than the smallest file, so that each file has a coarse sample.
        bits, sides = BITS_OF_GAPS, boxes[:, 2:] - boxes[:, :2]
        while 2 << bits <= min(1 << MAX_BITS, sides.min()) and grid.width * grid.height >> 2 * bits >= MANY_OF_GAPS:
            bits += 1
        plan = _divide(grid, boxes, np.ones_like(is_finer), bits, SAVING_OF_GAPS)
    return plan


def _divide(grid: TargetGrid, boxes: np.ndarray, is_finer: np.ndarray, bits: int, saving: int) -> FinerPlan | None:
    """Return the plan with a coarse cell of 2^bits finest ones; None unless it has `saving` times fewer samples.

    boxes: [files, 4], as in `plan_finer`. is_finer: bool [files], whether a file gets finer tiles.
    """
    # The coarse grid has every 2^bits-th sample. Finer tiles are stored besides, and together must be few enough.
    is_of_gaps = bool(is_finer.all())
    spare = (1 << bits) - 1 if is_of_gaps else 0  # no finest sample may be beyond the last coarse one
    width, height = ((count - 1 + spare >> bits) + 1 for count in (grid.width, grid.height))
    low = np.floor(boxes[is_finer, :2]).astype(np.int64) - (grid.column, grid.row)
    high = np.ceil(boxes[is_finer, 2:]).astype(np.int64) - (grid.column, grid.row)
    file_boxes = np.concatenate([low, high], axis=1)
    tiles = _count_tiles(grid, file_boxes)
    needed = width * height + tiles * SIDE * SIDE
    if bits < 1 or saving * needed > grid.width * grid.height or min(width, height) < 3:
        return None
    # The first coarse sample is on the first fine one, and its column and row are that one's >> bits. The bits that are
    # lost move the origin (x0, y0). So a coarse sample keeps its number when the extent grows by whole cells.
    column, row = grid.column >> bits, grid.row >> bits
    x0, y0 = grid.positions(np.array(grid.column - (column << bits)), np.array(grid.row - (row << bits)))
    coarse = grid._replace(x0=float(x0), y0=float(y0), column=column, row=row, width=width, height=height)
    coarse = coarse._replace(step_x=grid.step_x * 2**bits, step_y=grid.step_y * 2**bits)
    return FinerPlan(coarse, bits, is_of_gaps, file_boxes, tiles)


def _count_tiles(grid: TargetGrid, file_boxes: np.ndarray) -> int:
    """Return the number of finer tiles of a grid that the files meet, with the tiles next to these.

    file_boxes: int64 [files, 4], first column and row of the grid and last ones of each finer file.
    """
    is_tile = np.zeros((grid.height // SIDE + 1, grid.width // SIDE + 1), bool)
    for west, north, east, south in file_boxes // SIDE:
        is_tile[max(north - 1, 0) : south + 2, max(west - 1, 0) : east + 2] = True
    return int(is_tile.sum())
