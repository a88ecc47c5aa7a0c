# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a store's tiles, copied for a raster with another extent whose samples are at the same positions.

The tiles of both rasters must differ by whole columns and rows of tiles. `before` is the work of the earlier raster or
its tiles, `work` that of the new one. Each finished tile has a record. Its errors and ranges are in images, one for
each two levels of vertices (a group) and one for the raster's cells.
"""

import numpy as np

from ..field.shared_pages import NAMES, Paged, parts_of
from ..field.store_arrays import release_pages
from .tile_grid import OwnedArea, TileGrid, halved, owned_areas
from .tile_records import MEASURED, READ
from .tile_work import STORED, TileWork

TOLERANCE = 0.01  # samples by which the corners of two rasters may miss a whole number of samples
# In place of "above" in a record, so that these errors are measured again.
UNKNOWN: tuple[str, list] = ("", [])


def tiles_moved(before: TileWork, work: TileWork) -> tuple[int, int] | None:
    """Return the columns and rows that the tiles of an earlier raster have further east and north in another one.

    None if its tiles are not tiles of the other one, or its samples are stored in another way.
    """
    # All that decides how the samples and errors of a tile are stored.
    tiles = [(each.grid.bits, each.grid.levels, each.steps, each.holes, len(each.grid) > 1) for each in (before, work)]
    if tiles[0] != tiles[1]:
        return None
    moved, side = samples_moved(before, work), work.grid.side
    if moved is None or any(count % side for count in moved):
        return None
    return moved[0] // side, moved[1] // side


def samples_moved(before: TileWork, work: TileWork) -> tuple[int, int] | None:
    """Return the columns and rows that samples of an earlier raster have further east and north in another one.

    None if they are no samples of the other one. `corner` of a work: samples from the origin of the coordinate system
    to the south-western one, None if unknown.
    """
    if before.corner is None or work.corner is None:
        return (0, 0) if before.grid.lattice == work.grid.lattice else None
    exact = np.subtract(before.corner, work.corner)
    columns, rows = moved = np.round(exact)
    is_whole = np.abs(exact - moved).max() <= TOLERANCE  # false for NaN
    return (int(columns), int(rows)) if is_whole else None


def copy_moved(before: TileWork, work: TileWork, moved: tuple[int, int]) -> None:
    """Copy samples, errors and ranges of the tiles that an earlier raster has in common with that of a work.

    Digests of their inputs then decide which of them are used. Nothing is copied if the checksum of the earlier records
    differs. moved: columns and rows of tiles that the earlier ones have further east and north (`tiles_moved`). Raises
    TerrainError and OSError, before anything is written, if an array is damaged.
    """
    if not before.has_whole_records():
        return
    numbers = _common_tiles(before.grid, work.grid, moved)  # earlier number of a tile: its new one
    for name in STORED if numbers else ():
        before.verify(name)
    read, measured = before.records(READ), before.records(MEASURED)
    results = {name: before.published(name) for name in NAMES if numbers}  # mapped once, since each time checks all
    records = []
    for number, new in numbers.items():
        box, new_box = before.grid.box(number), work.grid.box(new)
        # Without the last samples, which are also the first ones of the eastern and the northern neighbour.
        owned, new_owned = before.grid.owned(box), work.grid.owned(new_box)
        if owned.shape != new_owned.shape:  # at the border of one of the rasters
            continue
        work.open("samples")[new_owned.area] = before.open("samples")[owned.area]
        # A tile with missing samples gets no record and is read again: the store has filled them and keeps no marks.
        if number in read and not read[number]["missing"]:
            records.append(read[number] | {"number": new})
        if "errors" in measured.get(number, ()) and before.grid.shape_of(box) == work.grid.shape_of(new_box):
            _copy_measured(before, results, number, work, new)
            # The errors of diamonds larger than a tile ("above") depend on the extent.
            records.append(measured[number] | {"number": new, "above": UNKNOWN})
    work.write_records(records)


def _common_tiles(before: TileGrid, grid: TileGrid, moved: tuple[int, int]) -> dict[int, int]:
    """Return the numbers of the tiles of an earlier grid that another one has, too, with their numbers there.

    moved: columns and rows of tiles that the earlier ones have further east and north.
    """
    numbers = {}
    for number in range(len(before)):
        row, column = divmod(number, before.columns)
        column, row = column + moved[0], row + moved[1]
        if 0 <= column < grid.columns and 0 <= row < grid.rows:
            numbers[number] = row * grid.columns + column
    return numbers


def _copy_measured(before: TileWork, results: dict[str, Paged], number: int, work: TileWork, new: int) -> None:
    """Copy the errors and ranges of tile `number` of an earlier raster to tile `new` of a work.

    results: both arrays of the earlier raster, by name. Their pages in memory are released, since they count as memory
    of this process.
    "borders" are the values of vertices near the tile's border as this tile alone was measured; the raster has the
    largest value of all tiles that share a vertex.
    Ranges are stored for every other sample only, so their layout is that of a grid at half the resolution.
    """
    work.open("borders")[new] = before.open("borders")[number]
    _copy_entries(before.grid, number, results["error"], work.grid, new, work.open("error"), has_cells=True)
    halves = halved(before.grid), number, results["ranges"], halved(work.grid), new, work.open("ranges")
    _copy_entries(*halves, has_cells=False)
    for array in results.values():
        for part in parts_of(array):
            release_pages(part)


def _copy_entries(
    grid: TileGrid, number: int, values: Paged, new_grid: TileGrid, new: int, whole: np.ndarray, has_cells: bool
) -> None:
    """Copy the entries of tile `number` of a grid from the array of its raster to tile `new` of another one.

    The coarsest group is left out if all its vertices are near the tile's border: those are computed again from
    "borders". grid, number, values: the earlier raster, its tile and its array. new_grid, new, whole: the same of the
    new raster. has_cells: the arrays have entries of cells, which follow the groups.
    """
    areas = owned_areas(grid, grid.box(number), has_cells)
    new_areas = owned_areas(new_grid, new_grid.box(new), has_cells)
    for area, new_area in zip(areas, new_areas, strict=True):
        is_cells = area.group == grid.local(grid.box(number)).groups  # the last area, after all groups
        if area.group < grid.inner_groups or is_cells:
            _copy_area(area, values, new_area, whole)


def _copy_area(area: OwnedArea, values: Paged, new_area: OwnedArea, whole: np.ndarray) -> None:
    """Copy a tile's entries of a group from the array of one raster to that of another.

    area, values: of the earlier raster; new_area, whole: of the new one. A tile at a raster's border writes up to the
    end of the image, so its two areas may differ in size; the entries that only one of them has are 0.
    """
    height, width = min(area.height, new_area.height), min(area.width, new_area.width)
    if area.is_paged and new_area.is_paged and (area.height, area.width) == (new_area.height, new_area.width):
        new_area.paged(whole)[:] = area.paged(values)
    else:
        whole[new_area.positions()[:height, :width]] = values[area.positions()[:height, :width]]
