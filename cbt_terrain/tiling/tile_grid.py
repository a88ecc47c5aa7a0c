# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of a raster, and the vertices that they share.

A tile is a square of 2**bits cells, aligned with the lattice, with its own small lattice of the same diamonds. A vertex
of level j is a multiple of 2**j samples: a middle of a side of cells of 2**(j + 1) samples (x / 2**j + y / 2**j odd) or
of such a cell (both odd).

Diamonds of a tile that touch its border depend on the tiles around it. Of cells of 2**(j + 1) samples these are the
cells and sides at the border: their vertices are on the border or 2**j samples from it (`near_border`). All others are
final in the tile. Diamonds of cells as large as a tile and larger depend on many tiles.

An array of a lattice (lattice.py) has one entry for each diamond, that is for its vertex. Two levels are a group, whose
entries form an image: a vertex at every 4^group-th sample, in pages of PAGE x PAGE. The raster's cells are the last
image. `Lattice.layout` has the first entry of each image and the number of pages in a row of it. `box`: first and last
samples of a tile; neighbours share them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ..field.lattice import PAGE, Lattice, TileBox, rows_of, tile_index
from ..field.shared_pages import Paged, image_pages

TILE_BITS = 11  # a tile of an import has 2**11 cells a side


class LatticeVertices(NamedTuple):
    """Vertices of a lattice, int64 [n], in samples, and their levels, int64 [n] or one for all."""

    x: np.ndarray
    y: np.ndarray
    level: np.ndarray | int

    def chosen(self, which: np.ndarray) -> "LatticeVertices":
        """Return the vertices for which `which` is true."""
        level = self.level if isinstance(self.level, int) else self.level[which]
        return LatticeVertices(self.x[which], self.y[which], level)


@dataclass(frozen=True)
class TileGrid:
    """The tiles of a raster with 2**bits cells a side, row by row from the south-west."""

    lattice: Lattice
    bits: int = TILE_BITS

    @property
    def side(self) -> int:
        """Return the cells along a side of a tile."""
        return 1 << self.bits

    @property
    def levels(self) -> int:
        """Return the levels of the root squares of a tile's lattice."""
        return min(self.bits, self.lattice.levels)

    @property
    def holds_roots(self) -> bool:
        """Return whether a tile contains whole root squares, so that no diamond extends over several tiles."""
        return self.lattice.levels <= self.bits

    @property
    def inner_groups(self) -> int:
        """Return the number of a tile's groups, the finest ones, with vertices far from its border.

        All vertices of the coarsest group of a tile that is one square are near its border (`near_border`).
        """
        return (self.levels + 1) // 2 - (self.levels == self.bits)

    @property
    def columns(self) -> int:
        """Return the number of tiles from west to east."""
        return -(-self.lattice.cells_x >> self.bits)

    @property
    def rows(self) -> int:
        """Return the number of tiles from south to north."""
        return -(-self.lattice.cells_y >> self.bits)

    def __len__(self) -> int:
        return self.columns * self.rows

    def box(self, number: int) -> TileBox:
        """Return the rectangle of samples of a tile. Tiles are numbered row by row from the south-west."""
        row, column = divmod(number, self.columns)
        x0, y0 = column << self.bits, row << self.bits
        return TileBox(x0, y0, min(x0 + self.side, self.lattice.cells_x), min(y0 + self.side, self.lattice.cells_y))

    def window(self, box: TileBox, margin: int) -> TileBox:
        """Return a tile with `margin` samples more on each side, as far as the raster reaches."""
        x1, y1 = min(box.x1 + margin, self.lattice.cells_x), min(box.y1 + margin, self.lattice.cells_y)
        return TileBox(max(box.x0 - margin, 0), max(box.y0 - margin, 0), x1, y1)

    def owned(self, box: TileBox) -> TileBox:
        """Return the samples of a tile without those that the eastern and the northern neighbour have too."""
        east, north = box.x1 < self.lattice.cells_x, box.y1 < self.lattice.cells_y
        return TileBox(box.x0, box.y0, box.x1 - east, box.y1 - north)

    def local(self, box: TileBox) -> Lattice:
        """Return the lattice of a tile, with the padding beyond the raster's border that has entries.

        The padding is at most one more root square along each axis.
        """
        lattice = self.lattice
        cells, span = (lattice.cells_x, lattice.cells_y), lattice.span
        # Root squares of 2^levels samples: those of the tile, rounded up, and one more if the tile ends at the raster's
        # border (`count`), but not beyond the squares of the raster (`end`).
        columns, rows = (
            min(-(-(last - first) >> self.levels) + (last == count), (end - first) >> self.levels)
            for first, last, count, end in zip(box[:2], box[2:], cells, span, strict=True)
        )
        size = box.x1 - box.x0, box.y1 - box.y0
        return Lattice(columns, rows, self.levels, lattice.step_x, lattice.step_y, *size)

    def shape_of(self, box: TileBox) -> tuple[Lattice, bool]:
        """Return the shape of a tile's results: its lattice with steps of 1 m, and `holds_roots`."""
        return replace(self.local(box), step_x=1.0, step_y=1.0), self.holds_roots

    @cached_property
    def near_border(self) -> LatticeVertices:
        """Return the vertices of a tile whose errors depend on its neighbours, in samples from its first one.

        A single tile has none.
        """
        by_level = [np.zeros((3, 0), np.int64)]
        for level in range(self.levels if len(self) > 1 else 0):
            half = 1 << level
            # All pairs of a coordinate along a border of the tile and one on the border or next to it. A last tile of
            # the raster also has vertices at side + half, in the padding.
            along = np.arange(0, self.side + half + 1, half)
            across = np.unique([0, half, self.side - half, self.side, self.side + half])
            x, y = (np.concatenate(pair) for pair in zip(_pairs(along, across), _pairs(across, along), strict=True))
            # one number for x and y, so that each vertex comes once
            chosen = np.unique((y * (4 * self.side) + x)[((x >> level) | (y >> level)) & 1 == 1])
            y, x = divmod(chosen, 4 * self.side)
            by_level.append(np.stack([x, y, np.full_like(x, level)]))
        return LatticeVertices(*np.concatenate(by_level, axis=1))


def _pairs(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of all pairs of two lists."""
    x, y = np.meshgrid(x, y)
    return x.ravel(), y.ravel()


def halved(grid: TileGrid) -> TileGrid:
    """Return the tiles of every other sample, in whose layout ranges of heights are stored.

    The two finest depths of diamonds have no ranges.
    """
    lattice = grid.lattice
    cells = (lattice.cells_x + 1) // 2, (lattice.cells_y + 1) // 2
    lattice = Lattice(lattice.columns, lattice.rows, lattice.levels - 1, cells_x=cells[0], cells_y=cells[1])
    return TileGrid(lattice, grid.bits - 1)


def exist(lattice: Lattice, vertices: LatticeVertices) -> np.ndarray:
    """Return whether the lattice has an entry for each vertex, bool [n]; vertices outside the raster have none."""
    counts = _extents(lattice)[vertices.level]  # columns and rows of cells, then the last ones of middles of sides
    x, y = vertices.x >> vertices.level, vertices.y >> vertices.level
    is_centre = (x & y & 1) == 1
    is_in_extent = np.where(
        is_centre, (x >> 1 < counts[..., 0]) & (y >> 1 < counts[..., 1]), (x <= counts[..., 2]) & (y <= counts[..., 3])
    )
    return is_in_extent & (vertices.x >= 0) & (vertices.y >= 0)


@lru_cache(maxsize=64)
def _extents(lattice: Lattice) -> np.ndarray:
    """Return the columns and rows of centres and of middles of sides with entries, int64 [levels, 4]."""
    depths = [2 * (lattice.levels - level) for level in range(lattice.levels)]
    return np.array([(*lattice.extent(depth - 1), *lattice.extent(depth)) for depth in depths]).reshape(-1, 4)


def entries_of(lattice: Lattice, vertices: LatticeVertices) -> np.ndarray:
    """Return the entries of vertices in the lattice's arrays, int64 [n]."""
    base, pages = lattice.layout()
    group = vertices.level // 2
    return base[group] + tile_index(vertices.x >> 2 * group, vertices.y >> 2 * group, pages[group])


def cell_entries(lattice: Lattice, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the entries of the raster's cells (x, y), int64 [n]."""
    base, pages = lattice.layout()
    return base[-2] + tile_index(x, y, pages[-1])


@dataclass(frozen=True)
class OwnedArea:
    """The area, in the image of a group of the raster's lattice, that one tile writes.

    Attributes:
        group: its number in the tile's lattice; the cells are the last.
        entries: entries of the image in the array of the raster.
        pages: pages in a row of the image.
        x, y: first vertex of the area.
        width, height: numbers of vertices; those beyond the image's last page are not there.
    """

    group: int
    entries: slice
    pages: int
    x: int
    y: int
    width: int
    height: int

    @property
    def is_paged(self) -> bool:
        """Return whether the area consists of whole pages."""
        return not (self.x | self.y | self.width | self.height) % PAGE

    def paged(self, whole: Paged) -> np.ndarray:
        """Return the pages of the area in the array of the raster, [rows, columns, PAGE * PAGE, ...].

        This is a view, or a copy of shared pages.
        """
        y, x = self.y // PAGE, self.x // PAGE
        rows, columns = slice(y, y + self.height // PAGE), slice(x, x + self.width // PAGE)
        return image_pages(whole, self.entries, self.pages, rows, columns)

    def positions(self) -> np.ndarray:
        """Return the entries of the vertices in the array of the raster, int64 [rows, columns]."""
        y = np.arange(self.y, self.y + self.height)[:, None]
        x = np.arange(self.x, self.x + self.width)
        return self.entries.start + tile_index(x, y, self.pages)


def owned_areas(grid: TileGrid, box: TileBox, with_cells: bool = True) -> Iterator[OwnedArea]:
    """Yield the area of each group's image that a tile writes; it ends before the eastern and northern neighbours'.

    with_cells: also yield the area of the raster's cells, the last group.
    """
    base, pages = grid.lattice.layout()
    groups = grid.local(box).groups
    for group in range(groups + with_cells):
        # An image has a vertex at every 2^shift-th sample, or a cell for each one of the raster.
        shift, raster_group = (2 * group, group) if group < groups else (0, len(pages) - 1)
        # The entries of the group's image in the array of the raster, and the pages in a row of it.
        entries, row_pages = slice(int(base[raster_group]), int(base[raster_group + 1])), int(pages[raster_group])
        x, y, count = box.x0 >> shift, box.y0 >> shift, -(-grid.side >> shift)
        # the last tiles write up to the end of the image
        width = row_pages * PAGE - x if box.x1 == grid.lattice.cells_x else count
        height = (entries.stop - entries.start) // (row_pages * PAGE) - y if box.y1 == grid.lattice.cells_y else count
        yield OwnedArea(group, entries, row_pages, x, y, width, height)


def put(grid: TileGrid, box: TileBox, values: np.ndarray, whole: np.ndarray) -> None:
    """Write the entries of a tile's lattice into the array of the raster.

    grid: tiles of the lattice of `whole`. values: in the layout of `grid.local(box)`.
    """
    local = grid.local(box)
    base, pages = local.layout()
    for area in owned_areas(grid, box, len(values) == local.node_count):  # ranges have no entries of cells
        source, row_pages = values[base[area.group] : base[area.group + 1]], int(pages[area.group])
        if area.is_paged:  # it consists of whole pages, which are copied at once
            target = area.paged(whole)
            high, wide = target.shape[:2]  # pages
            target[:] = source.reshape(-1, row_pages, *target.shape[2:])[:high, :wide]
        else:
            # The vertices of the pages in rows, without those beyond the area.
            rows = rows_of(source, row_pages)[: area.height, : area.width]
            whole[area.positions()[: rows.shape[0], : rows.shape[1]]] = rows


def translate(grid: TileGrid, box: TileBox, whole: np.ndarray, tables: np.ndarray) -> None:
    """Replace the codes of a tile in the array of the raster, in place. A code is an error as a byte (codes.py).

    tables: uint8 [groups of the tile and cells, 256], the new code of each old one. whole: that array. An area of whole
    pages is a view of it; other areas are reached by their entries.
    """
    for area in owned_areas(grid, box):
        table = tables[area.group].tobytes()
        target, entries = (area.paged(whole), None) if area.is_paged else (whole, area.positions())
        values = np.ascontiguousarray(target if entries is None else target[entries])  # `tobytes` of a view is slow
        values = np.frombuffer(values.tobytes().translate(table), np.uint8).reshape(values.shape)
        target[... if entries is None else entries] = values
