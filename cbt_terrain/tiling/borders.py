# SPDX-License-Identifier: GPL-3.0-or-later
"""Diamonds that depend on several tiles: their values follow from their children, from fine to coarse.

A diamond is named by its vertex, the sample that splits it. Values are codes: bytes, each the index of an error in
metres in a table of 256. Two levels of vertices are a group and share a table, 2^exponent metres at its largest; the
raster's cells have the last table. The entries of a coarser group's table are entries of a finer one's (codes.py), so
the code of a maximum of errors is the code of the maximum of their codes' metres.

`grid`: the tiles of the whole raster. An array of the raster is passed as a function that maps it anew for each part of
the work, because pages that were touched count as memory of the process.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..field import codes
from ..field.lattice import Lattice
from .measure_tile import LargeError
from .tile_grid import LatticeVertices, TileGrid, cell_entries, entries_of, exist, halved

GROUND_AND_HOLE = 3  # kind of the cells below a diamond: ground 1, hole 2, both 3
ROWS = 1 << 11  # rows of vertices together: Linux maps up to 2 MB of a file around each entry that is read
Opened = Callable[[], np.ndarray]  # maps an array anew: its pages count as memory of this process until it is closed


def pass_depths(grid: TileGrid) -> Iterator[tuple[int, bool]]:
    """Yield (level, is_centre) of each depth of vertices that depend on several tiles, the deepest first, if any.

    level: log2 of half the side of a cell, samples. is_centre: the vertices are centres of cells, otherwise middles of
    their sides.
    """
    levels = range(grid.lattice.levels if len(grid) > 1 else 0)
    return ((level, is_centre) for level in levels for is_centre in (False, True))


def shared_vertices(grid: TileGrid, level: int, is_centre: bool) -> Iterator[LatticeVertices]:
    """Yield the vertices of one depth that depend on several tiles; some may come twice.

    They are in parts, each of up to ROWS rows along a line between tiles. level: log2 of half the side of a cell,
    samples. is_centre: the vertices are centres of such cells, otherwise middles of their sides.
    """
    half = 1 << level
    # `lines`: blocks of vertices, each the coordinates (x, y) of its columns and rows. Beyond the raster, vertices of
    # up to two more cells (of 2 * half samples) have entries, too, as far as its root squares reach (`span`).
    ends = [min(cells + 4 * half, span) + 1 for cells, span in zip(_cells(grid), grid.lattice.span, strict=True)]
    along = [np.arange(0, end, half) for end in ends]
    if 2 * half > grid.side or (is_centre and 2 * half == grid.side):
        lines: list = [(along[0], along[1])]  # no tile holds such a diamond: all vertices
    else:
        near = np.array([-half, 0, half])  # vertices on a line between tiles, and on both sides of it
        lines = [(near[near + x >= 0] + x, along[1]) for x in range(0, ends[0], grid.side)]
        lines += [(along[0], near[near + y >= 0] + y) for y in range(0, ends[1], grid.side)]
    parts = ((x, y[row : row + ROWS]) for x, y in lines for row in range(0, len(y), ROWS))
    for x, y in parts:
        x, y = (values.ravel() for values in np.meshgrid(x, y))
        odd_x, odd_y = x >> level & 1, y >> level & 1
        chosen = (odd_x & odd_y) == 1 if is_centre else (odd_x ^ odd_y) == 1
        vertices = LatticeVertices(x[chosen], y[chosen], level)
        vertices = vertices.chosen(exist(grid.lattice, vertices))
        if len(vertices.x):
            yield vertices


def _cells(grid: TileGrid) -> tuple[int, int]:
    """Return the number of the raster's cells from west to east and from south to north."""
    return grid.lattice.cells_x, grid.lattice.cells_y


def children_of(
    lattice: Lattice, vertices: LatticeVertices, is_centre: bool
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield, for each of the up to four children of diamonds, its entries in the array, and which vertices have it.

    The children of the diamond at a cell's centre are those of its four sides. The children of a side's diamond are
    those at the centres of the four cells of half that size around the side's middle. lattice: that of the array.
    vertices: split vertices of the diamonds. is_centre: they are centres of cells, otherwise middles of their sides.
    """
    x, y, level = vertices
    half = 1 << level
    if is_centre:
        for dx, dy in ((-half, 0), (half, 0), (0, -half), (0, half)):
            child = LatticeVertices(x + dx, y + dy, level)
            yield entries_of(lattice, child), exist(lattice, child)
    else:
        for right, up in ((-1, -1), (0, -1), (-1, 0), (0, 0)):  # the cell before (-1) or after (0) the middle, by axis
            if level == 0:  # the children are single cells
                i, j = x + right, y + up
                columns, rows = lattice.extent(lattice.cell_depth)
                yield cell_entries(lattice, i, j), (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
            else:
                quarter = half // 2
                child = LatticeVertices(x + quarter * (2 * right + 1), y + quarter * (2 * up + 1), level - 1)
                yield entries_of(lattice, child), exist(lattice, child)


def raise_kinds(grid: TileGrid, opened: Opened) -> list[tuple[int, bool]]:
    """Unite the kinds of cells below the shared vertices; return (level, is_centre) of the depths with both kinds.

    opened: function that maps the kinds (ground 1, hole 2, both 3), uint8 like the errors.
    """
    both: dict[tuple[int, bool], None] = {}
    for level, is_centre in pass_depths(grid):
        for vertices in shared_vertices(grid, level, is_centre):
            kinds = opened()
            entries = entries_of(grid.lattice, vertices)
            united = kinds[entries]
            for child, has_child in children_of(grid.lattice, vertices, is_centre):
                if level or is_centre:  # sides of single cells have their kinds from the tiles
                    united[has_child] |= kinds[child[has_child]]
            kinds[entries] = united
            if (united == GROUND_AND_HOLE).any():
                both[level, is_centre] = None
    return list(both)


def raise_errors(
    grid: TileGrid, opened: Opened, table: np.ndarray, kinds: Opened | None, longest: Callable[[int, bool], float]
) -> None:
    """Raise the errors of the shared vertices to the largest of their children's.

    Args:
        opened: maps the codes of the raster.
        table: metres of the codes of each group, float32 [groups + 1, 256].
        kinds: maps the kinds of cells (`raise_kinds`); None without holes.
        longest: longest(level, is_centre) returns the longest edge of such diamonds, metres. The error of a diamond
            with ground and hole is at least that, so that it is split.
    """
    for level, is_centre in pass_depths(grid):
        below = level if is_centre else level - 1  # level of the children, -1 for cells, whose table is the last
        # Two levels are one group, with one table.
        code_metres, child_code_metres = table[level // 2], table[below // 2 if below >= 0 else -1]
        for vertices in shared_vertices(grid, level, is_centre):
            stored = opened()
            entries = entries_of(grid.lattice, vertices)
            metres = code_metres[stored[entries]]
            for child, has_child in children_of(grid.lattice, vertices, is_centre):
                metres[has_child] = np.maximum(metres[has_child], child_code_metres[stored[child[has_child]]])
            if kinds is not None:
                both = kinds()[entries] == GROUND_AND_HOLE
                metres[both] = np.maximum(metres[both], np.float32(longest(level, is_centre)))
            stored[entries] = np.searchsorted(code_metres, metres, side="left")  # the smallest code that is not below


def unite_ranges(grid: TileGrid, opened: Opened) -> None:
    """Write to the vertices that several tiles share the union of their children's ranges of heights, depth by depth.

    The finest vertices are complete already. grid: tiles of the whole raster. opened: maps the ranges of the raster.
    """
    half = halved(grid)  # every other sample has a range
    # A range is the numbers of the lowest and the highest height. This inverts the lowest, so that the maximum of both
    # numbers is the union, and (0, 0) the empty range.
    flip = np.array([65535, 0], np.uint16)
    for level, is_centre in pass_depths(half):
        if not level and not is_centre:
            continue  # they are complete in each tile
        for vertices in shared_vertices(half, level, is_centre):
            ranges = opened()
            united = np.zeros((len(vertices.x), 2), np.uint16)
            for child, has_child in children_of(half.lattice, vertices, is_centre):
                united[has_child] = np.maximum(united[has_child], ranges[child[has_child]] ^ flip)
            ranges[entries_of(half.lattice, vertices)] = united ^ flip


def near_vertices(grid: TileGrid, number: int) -> tuple[np.ndarray, LatticeVertices]:
    """Return which of `TileGrid.near_border` a tile has, bool [n], and these vertices, in samples of the raster."""
    near, box = grid.near_border, grid.box(number)
    exists = exist(grid.local(box), near)
    x, y, level = near.chosen(exists)
    return exists, LatticeVertices(x + box.x0, y + box.y0, level)


def join_borders(
    grid: TileGrid,
    tiles: Sequence[tuple[int, Callable[[], np.ndarray]]],
    opened: Opened,
    tables: Callable[[int], np.ndarray],
    unite: np.ufunc = np.maximum,
) -> None:
    """Write the values of vertices near the borders of tiles into the array of the raster.

    A vertex near several tiles gets the values of all of them, united by `unite`: the maximum of codes of errors, or
    `np.bitwise_or` of kinds, flags for ground and hole. Vertices are set to 0 before.

    Args:
        tiles: their numbers, and functions that return their values, uint8, one for each vertex of
            `TileGrid.near_border`.
        opened: maps the array of the raster.
        tables: tables(number) returns the values of the raster for a tile's values, uint8 [groups + 1, 256].
    """
    for is_first in (True, False):
        for number, values in tiles:
            # A tile at the raster's border lacks some vertices of `TileGrid.near_border`: `exists` is False there.
            exists, vertices = near_vertices(grid, number)
            whole, entries = opened(), entries_of(grid.lattice, vertices)
            if is_first:
                whole[entries] = 0
            else:
                # Tables have a row for each group of two levels.
                translated = tables(number)[np.asarray(vertices.level) // 2, values()[exists]]
                whole[entries] = unite(whole[entries], translated)


def write_large(grid: TileGrid, large: Sequence[LargeError], table: np.ndarray, opened: Opened) -> None:
    """Write the errors of diamonds of cells as large as a tile or larger, each the largest over all tiles.

    A level has cells of 2^(level + 1) samples, so tiles are the cells of level bits - 1. large: these errors over
    single tiles. table: metres of the codes, float32 [groups, 256]. opened: function that maps the codes of the
    terrain.
    """
    for level in range(grid.bits - 1, grid.lattice.levels):
        stored = opened()
        # Vertices are set to 0 before, except the centres of tiles, which `join_borders` has written.
        for is_centre in (True, False) if level >= grid.bits else ():
            for vertices in shared_vertices(grid, level, is_centre):
                stored[entries_of(grid.lattice, vertices)] = 0
        chosen = [item for item in large if item.level == level]
        if chosen:
            x, y = (np.array([item[axis] for item in chosen], np.int64) for axis in (0, 1))
            metres = np.array([item.error for item in chosen], np.float32)
            entries = entries_of(grid.lattice, LatticeVertices(x, y, level))
            new_codes = np.searchsorted(table[level // 2], metres, side="left").astype(np.uint8)
            order = np.argsort(new_codes, kind="stable")  # the last of several for one entry remains
            entries, new_codes = entries[order], new_codes[order]
            stored[entries] = np.maximum(stored[entries], new_codes)


def tables_between(before: Sequence[int], wanted: Sequence[int]) -> np.ndarray:
    """Return tables from old codes to new ones, uint8 [groups, 256], where the groups' tables of metres change.

    before, wanted: old and new exponents of these tables; none becomes smaller. The entries of the new tables are
    entries of the old ones, so rounding twice is rounding once.
    """
    pairs = zip(codes.tables(before), codes.tables(wanted), strict=True)
    return np.array([np.searchsorted(new, old, side="left") for old, new in pairs], np.uint8)
