# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a store's tiles, copied for a raster with another extent, whose tiles are others by a whole number."""

import numpy as np

from ..field.store_arrays import verify_array
from .tile_grid import OwnedArea, TileGrid, halved, owned_areas
from .tile_records import MEASURED, READ
from .tile_work import STORED, TileWork

TOLERANCE = 0.01  # samples by which the corners of two rasters may miss a whole number of samples
UNKNOWN: tuple[str, list] = ("", [])  # "above" of a record: errors of large diamonds, which depend on the extent


def tiles_moved(before: TileWork, work: TileWork) -> tuple[int, int] | None:
    """Return the columns and rows that the tiles of an earlier raster have further east and north in another one.

    None if its tiles are not tiles of the other one, or its samples are stored in another way.
    """
    tiles = [(each.grid.bits, each.grid.levels, each.steps, each.holes, len(each.grid) > 1) for each in (before, work)]
    if tiles[0] != tiles[1]:
        return None
    moved, side = samples_moved(before, work), work.grid.side
    if moved is None or any(count % side for count in moved):
        return None
    return moved[0] // side, moved[1] // side


def samples_moved(before: TileWork, work: TileWork) -> tuple[int, int] | None:
    """Return the columns and rows that samples of an earlier raster have further east and north in another one.

    None if they are no samples of the other one.
    """
    if before.corner is None or work.corner is None:
        return (0, 0) if before.grid.lattice == work.grid.lattice else None
    exact = np.subtract(before.corner, work.corner)
    columns, rows = moved = np.round(exact)
    is_whole = np.abs(exact - moved).max() <= TOLERANCE  # false for NaN
    return (int(columns), int(rows)) if is_whole else None


def copy_moved(before: TileWork, work: TileWork, moved: tuple[int, int]) -> None:
    """Copy samples, errors and ranges of the tiles that an earlier raster has in common with that of a work.

    Digests of their inputs then decide which of them are used. Nothing is copied without whole records. moved: of
    `tiles_moved`. Raises TerrainError and OSError, before anything is written, if an array is damaged.
    """
    if not before.has_whole_records():
        return
    numbers = _common_tiles(before.grid, work.grid, moved)
    for name in STORED if numbers else ():
        verify_array(before.folder / f"{name}.npy", *before.arrays()[name])
    read, measured = before.records(READ), before.records(MEASURED)
    records = []
    for number, new in numbers.items():
        box, new_box = before.grid.box(number), work.grid.box(new)
        owned, new_owned = before.grid.owned(box), work.grid.owned(new_box)
        if owned.shape != new_owned.shape:
            continue
        work.open("samples")[new_owned.area] = before.open("samples")[owned.area]
        if number in read and not read[number]["missing"]:
            records.append(read[number] | {"number": new})
        if "errors" in measured.get(number, ()) and before.grid.shape_of(box) == work.grid.shape_of(new_box):
            _copy_measured(before, number, work, new)
            records.append(measured[number] | {"number": new, "above": UNKNOWN})
    work.write_records(records)


def _common_tiles(before: TileGrid, grid: TileGrid, moved: tuple[int, int]) -> dict[int, int]:
    """Return the numbers of the tiles of an earlier grid that another one has, too, with their numbers there."""
    numbers = {}
    for number in range(len(before)):
        row, column = divmod(number, before.columns)
        column, row = column + moved[0], row + moved[1]
        if 0 <= column < grid.columns and 0 <= row < grid.rows:
            numbers[number] = row * grid.columns + column
    return numbers


def _copy_measured(before: TileWork, number: int, work: TileWork, new: int) -> None:
    """Copy the errors and ranges of tile `number` of an earlier raster to tile `new` of a work."""
    work.open("borders")[new] = before.open("borders")[number]
    _copy_entries(before.grid, number, before.open("error"), work.grid, new, work.open("error"), has_cells=True)
    halves = halved(before.grid), number, before.open("ranges"), halved(work.grid), new, work.open("ranges")
    _copy_entries(*halves, has_cells=False)


def _copy_entries(
    grid: TileGrid, number: int, values: np.ndarray, new_grid: TileGrid, new: int, whole: np.ndarray, has_cells: bool
) -> None:
    """Copy the entries of tile `number` of a grid from the array of its raster to tile `new` of another one.

    Groups that are joined anew with those of neighbours are left out. has_cells: the arrays have entries of cells.
    """
    areas = owned_areas(grid, grid.box(number), has_cells)
    new_areas = owned_areas(new_grid, new_grid.box(new), has_cells)
    for area, new_area in zip(areas, new_areas, strict=True):
        if area.group < grid.inner_groups or area.group == grid.local(grid.box(number)).groups:
            _copy_area(area, values, new_area, whole)


def _copy_area(area: OwnedArea, values: np.ndarray, new_area: OwnedArea, whole: np.ndarray) -> None:
    """Copy a tile's entries of a group from the array of one raster to that of another.

    Tiles at the border write up to the end of the image, whose pages differ; entries beyond the shorter one are 0.
    """
    height, width = min(area.height, new_area.height), min(area.width, new_area.width)
    if area.is_paged and new_area.is_paged and (area.height, area.width) == (new_area.height, new_area.width):
        new_area.paged(whole)[:] = area.paged(values)
    else:
        whole[new_area.positions()[:height, :width]] = values[area.positions()[:height, :width]]
