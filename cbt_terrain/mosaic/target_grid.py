# SPDX-License-Identifier: GPL-3.0-or-later
"""The grid of a mosaic: its coordinate system, its step and its extent. It follows from headers alone."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError, shown
from ..field.lattice import SIDE_BITS, fit
from ..rasters.file_grid import unit_lengths
from ..rasters.raster import NEWEST, RESOLUTION, ImportSettings
from ..rasters.reproject import utm_zone
from ..view.linear import length
from .catalogue import SourceTile
from .systems import crs_of, period_of, projected

SIDE_POINTS = 33  # of each side of a tile, whose positions define the extent
MIDDLE = -3  # number of a tile's middle among its points
MAX_INDEX = 2.0**40  # samples from a system's origin
MAX_RETURN = 1.0  # samples by which the way to the target system and back may miss
ALIGNED = 1e-6  # samples


class TargetGrid(NamedTuple):
    """A straight grid with the north up.

    Samples have whole numbers: column k is at x0 + k * step_x, row k at y0 - k * step_y. So a sample keeps its number
    and its value when the extent grows.

    Attributes:
        crs: name of the coordinate system; "" for none.
        x0, y0, step_x, step_y: of the formula above, in units of the system.
        column: number of the first column.
        row: number of the first row, in the north.
        width, height: number of columns and rows.
    """

    crs: str
    x0: float
    y0: float
    step_x: float
    step_y: float
    column: int
    row: int
    width: int
    height: int

    def positions(self, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y, in the grid's coordinate system, of numbers of columns and rows."""
        return self.x0 + columns * self.step_x, self.y0 - rows * self.step_y

    def indices(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the numbers, float64, of the column and the row of positions."""
        return (x - self.x0) / self.step_x, (self.y0 - y) / self.step_y

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """Return the geotransform (a, b, c, d, e, f): from columns and rows of cells' corners to x and y."""
        west = self.x0 + (self.column - 0.5) * self.step_x
        north = self.y0 - (self.row - 0.5) * self.step_y
        return self.step_x, 0.0, west, 0.0, -self.step_y, north


class Footprints(NamedTuple):
    """Boxes of tiles in a system: float64 [tiles, 4], lowest x and y, highest x and y of their outer samples."""

    boxes: np.ndarray
    steps: np.ndarray  # float64 [tiles, 2]: steps along x and y at a tile's middle


def choose_grid(tiles: Sequence[SourceTile], settings: ImportSettings) -> TargetGrid:
    """Return the grid of a mosaic of tiles, given in the order of the sources. Raises TerrainError.

    Its step is that of the finest tile or of the settings. If that tile is straight in the grid's system and its step
    divides the grid's, samples of the grid are on its samples.
    """
    crs = _target_crs(tiles, settings)
    tile_footprints = footprints(tiles, crs)
    # The smallest cell; among equal ones a tile in the grid's system, then the first.
    finest = min(
        range(len(tiles)),
        key=lambda n: (tile_footprints.steps[n, 0] * tile_footprints.steps[n, 1], tiles[n].crs != crs, n),
    )
    reference = tiles[finest] if tiles[finest].crs == crs and tiles[finest].is_straight else None
    low, high = tile_footprints.boxes[:, :2].min(axis=0), tile_footprints.boxes[:, 2:].max(axis=0)
    step_x, step_y = map(float, tile_footprints.steps[finest])
    metres_x, metres_y = unit_lengths(crs_of(crs) if crs else None, float(low[1] + high[1]) / 2)
    if settings.step is not None:  # in metres; steps of the grid are in units of its system
        _check_step(settings.step, (high - low) * (metres_x, metres_y))
        step_x, step_y = settings.step / metres_x, settings.step / metres_y
    x0, y0 = (0.0, 0.0)  # where column 0 and row 0 of the grid are: a sample of the reference if the steps fit
    if reference is not None and (settings.step is None or _divides(reference, step_x, step_y)):
        x0, y0 = reference.position(0, 0)
        if settings.step is None:
            step_x, step_y = abs(reference.transform[0]), abs(reference.transform[4])
    numbers = np.array(  # of the first column and row and of the last ones
        [(low[0] - x0) / step_x, (y0 - high[1]) / step_y, (high[0] - x0) / step_x, (y0 - low[1]) / step_y]
    )
    if not np.abs(numbers).max() < MAX_INDEX:
        what = f"Steps of {step_x:g} x {step_y:g} are too small for coordinates in {shown(crs, 80)}"
        raise TerrainError(what, fix="give a larger --step")
    # The samples inside the extent; one on its border counts, however the number is rounded (ALIGNED).
    column, row = (math.ceil(number - ALIGNED) for number in numbers[:2].tolist())
    end_column, end_row = (math.floor(number + ALIGNED) for number in numbers[2:].tolist())
    width, height = max(end_column - column, 0) + 1, max(end_row - row, 0) + 1
    if not settings.quick:
        _check_size(width, height, step_x * metres_x, step_y * metres_y)
    return TargetGrid(crs, x0, y0, step_x, step_y, column, row, width, height)


def footprints(tiles: Sequence[SourceTile], crs: str) -> Footprints:
    """Return the boxes and steps of tiles in a system. Raises TerrainError for a tile that has no place there.

    Boxes are moved by whole turns of longitude, so that their middles are within 180 degrees of the first one's. If the
    widest box has more than half the globe, it takes the place of the first. So tiles on both sides of the date line
    are neighbours. crs: name of the system.
    """
    boxes, steps = np.empty((len(tiles), 4)), np.empty((len(tiles), 2))
    period = period_of(crs)
    for name in dict.fromkeys(tile.crs for tile in tiles):
        numbers = [n for n, tile in enumerate(tiles) if tile.crs == name]
        points = np.stack([_outline(tiles[n]) for n in numbers])  # [tiles, 2 (x, y in their system), points]
        x, y = projected(name, crs, points[:, 0].ravel(), points[:, 1].ravel())
        back_x, back_y = projected(crs, name, x, y)  # should be `points` again, else the tile has no place in `crs`
        x, y = x.reshape(points[:, 0].shape), y.reshape(points[:, 0].shape)
        back = np.stack([back_x.reshape(x.shape), back_y.reshape(x.shape)], axis=1)
        for row, n in enumerate(numbers):
            _check_return(tiles[n], crs, back[row] - points[row])
            if period and name != crs:  # the tile's own longitudes are continuous
                x[row] -= period * np.round((x[row] - x[row, MIDDLE]) / period)
            border_x, border_y = x[row, :-3], y[row, :-3]  # the last three points give the steps
            boxes[n] = border_x.min(), border_y.min(), border_x.max(), border_y.max()
            steps[n] = _steps(x[row, -3:], y[row, -3:])
    if period:  # move the boxes by whole turns to the anchor, the middle of the first or of a very wide one
        middles, widths = (boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 2] - boxes[:, 0]
        anchor = middles[np.argmax(widths) if widths.max() > period / 2 else 0]
        turns = np.round((middles - anchor) / period - ALIGNED)  # tiles at 180 degrees are all in the east
        boxes[:, [0, 2]] -= period * turns[:, None]
    return Footprints(boxes, steps)


def rank_tiles(tiles: Sequence[SourceTile], footprints: Footprints, settings: ImportSettings) -> np.ndarray:
    """Return the numbers of tiles in ascending order of their priority; of equal ones the later is higher.

    footprints: boxes and steps of the tiles.
    """
    if settings.priority == RESOLUTION:
        return np.argsort(-(footprints.steps[:, 0] * footprints.steps[:, 1]), kind="stable")
    if settings.priority == NEWEST:
        return np.argsort([tile.changed_ns for tile in tiles], kind="stable")
    return np.arange(len(tiles))


def _outline(tile: SourceTile) -> np.ndarray:
    """Return points of a tile's border, and its middle and the next ones along a row and a column: float64 [2, n].

    They are x and y in the tile's coordinate system.
    """
    right, bottom = tile.width - 1.0, tile.height - 1.0
    t = np.linspace(0.0, 1.0, SIDE_POINTS)
    zero, middle = np.zeros_like(t), (right / 2, bottom / 2)
    columns = np.concatenate([t * right, t * right, zero, zero + right, middle[0] + np.array([0.0, 1.0, 0.0])])
    rows = np.concatenate([zero, zero + bottom, t * bottom, t * bottom, middle[1] + np.array([0.0, 0.0, 1.0])])
    return np.stack(tile.position(columns, rows))


def _steps(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return steps along x and y of a straight grid as dense as a tile.

    x, y: float64 [3] each, of the tile's middle and of the next samples along a row and along a column. A tile that is
    almost parallel to the axes keeps its step along a row; any other has squares of equal area.
    """
    column, row = (x[1] - x[0], y[1] - y[0]), (x[2] - x[0], y[2] - y[0])
    area = abs(column[0] * row[1] - column[1] * row[0])
    if abs(column[1]) < 0.1 * length(column):
        return length(column), area / length(column)
    if abs(column[0]) < 0.1 * length(column):
        return area / length(column), length(column)
    return math.sqrt(area), math.sqrt(area)


def _check_return(tile: SourceTile, crs: str, missed: np.ndarray) -> None:
    """Raise TerrainError for a tile whose positions do not survive the way to the target system and back.

    missed: float64 [2, n], the differences in x and y; whole turns of longitude are removed from it in place. crs: name
    of the target system.
    """
    a, b, _, d, e, _ = tile.transform
    cell, period = max(length((a, d)), length((b, e))), period_of(tile.crs)
    if period:
        missed[0] -= period * np.round(missed[0] / period)
    if not np.abs(missed).max() <= MAX_RETURN * cell:
        raise TerrainError(
            f"{shown(tile.path)} in {shown(tile.crs, 80)} has no place in {shown(crs, 80)}",
            expected="files that one coordinate system covers",
            fix="give another target (--project utm or EPSG:n), or leave the file out",
        )


def _target_crs(tiles: Sequence[SourceTile], settings: ImportSettings) -> str:
    """Return the name of the mosaic's system: the requested one, the first projected one, or the first one.

    "" if no file names one. Raises TerrainError if only some do or one is needed, and for a request that is no
    projected system.
    """
    without = [tile for tile in tiles if not tile.crs]
    if without and (settings.project or len(without) < len(tiles)):
        raise TerrainError(
            f"{shown(without[0].path)} names no coordinate system"
            + (f", and {len(without) - 1:,} more files name none" if len(without) > 1 else ""),
            expected="one in every file of a mosaic",
            fix="give it one (gdal_edit.py -a_srs, or a .prj file beside it), or leave it out",
        )
    if settings.project.upper() == "UTM":
        boxes = footprints(tiles, "EPSG:4326").boxes
        # of the middle of all tiles
        return utm_zone("The mosaic", *(float(boxes[:, k].min() + boxes[:, k + 2].max()) / 2 for k in (0, 1)))
    if settings.project:
        name = f"EPSG:{int(settings.project.partition(':')[2])}"
        if not crs_of(name).is_projected:
            raise TerrainError(
                f"{name} does not measure in metres or feet", expected="a projected system, as EPSG:32632"
            )
        return name
    names = list(dict.fromkeys(tile.crs for tile in tiles))
    return next((name for name in names if name and crs_of(name).is_projected), names[0])


def _divides(tile: SourceTile, step_x: float, step_y: float) -> bool:
    """Return whether a step is a whole number of a tile's samples, so that some are copied exactly.

    step_x, step_y: in units of the tile's system.
    """
    ratios = step_x / abs(tile.transform[0]), step_y / abs(tile.transform[4])
    return all(ratio > 0.5 and abs(ratio - round(ratio)) < ALIGNED for ratio in ratios)


def _check_step(step: float, extent: np.ndarray) -> None:
    """Raise TerrainError for a step that is longer than the mosaic, whose samples would be outside of it.

    extent: metres from the first to the last sample in x and y; 0 for one row or column, which has any step.
    """
    if (step > extent[extent > 0.0]).any():
        what = f"A step of {step:g} m is longer than the mosaic of {extent[0]:,.6g} x {extent[1]:,.6g} m"
        raise TerrainError(what, fix="give a shorter step (--step)")


def _check_size(width: int, height: int, step_x: float, step_y: float) -> None:
    """Raise TerrainError for a grid with more samples than a store can hold, and name the step that fits.

    step_x, step_y: metres at the mosaic's middle.
    """
    if min(width, height) < 2 or fit(width, height).is_addressable:
        return
    # Find by bisection the smallest factor on the step whose grid a store can address (`fit` is its lattice).
    low, high = 1.0, float(max(width, height))  # factors: too fine, and coarse enough
    while high > 1.01 * low:
        factor = math.sqrt(low * high)
        size = max(math.ceil(width / factor), 2), max(math.ceil(height / factor), 2)
        low, high = (low, factor) if fit(*size).is_addressable else (factor, high)
    step = max(step_x, step_y) * high
    shown_step = float(f"{step:.2g}")
    shown_step = shown_step if shown_step >= step else float(f"{step * 1.05:.2g}")  # rounded up
    raise TerrainError(
        f"The mosaic would have {width:,} x {height:,} samples",
        expected=f"at most 2^{SIDE_BITS} in a row or a column",
        fix=f"give a coarser step (--step {shown_step:g}), or fewer files",
    )
