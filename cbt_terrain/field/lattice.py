# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice: a grid of root squares, each a power of two of raster cells wide, and the layout of its diamonds.

Few rasters fill their lattice. They share the south-western corner. The area of the lattice beyond the raster's border
in the east and north is padding: a vertex there has the height of the nearest border sample. Diamonds whose box
(`reach_of` in kernels/refine/stored_errors.py) is entirely beyond the border are never split, and have no entry.

A diamond is the pair of triangles that share a longest edge. Splitting it creates one vertex, the edge's middle, so one
entry per diamond is one entry per vertex. Above the raster's cells that vertex is a sample, and every sample is the
split vertex of at most one diamond. Inside a square of side 2^k samples depth 2q + 1 (q = 0 .. k - 1) holds the centres
of cells of side 2^(k-q), depth 2q + 2 the middles of their sides, and depth 2k + 1 the centres of the raster's cells.

The walk visits a diamond and then its children, one or two bisections below and next to it, so their entries are close
together. Group g holds the four depths with q = k - 1 - 2g and q = k - 2 - 2g: of the samples at multiples of 4^g all
but those at multiples of 4^(g+1). It is an image of these samples in tiles of 4 x 4 and pages of 8 x 8 tiles. So a
cache line of errors, which are bytes, holds four bisections of four neighbouring positions, and only visited pages of a
memory-mapped array are read. Ranges of heights have the same layout for every other sample. The centres of the raster's
cells follow as a separate image. Entries without a diamond (one in sixteen for the vertices of the next group, and the
rest of the pages at the border) are 0.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError

# Coordinates of the lattice are int32, and so are borders of a diamond's box, up to twice its square's side away: cells
# along a side of all squares are 2^30 at most, and of one square 2^29.
SIDE_BITS, SQUARE_BITS = 30, 29
# A leaf is drawn as 4**meshlet triangles, 4**MAX_MESHLET at most.
MAX_MESHLET = 4
# Anchors are multiples of this number of metres, which float32 holds exactly. Up to NEAR metres from the middle of a
# raster none is needed: float32 has steps of a quarter of a millimetre there.
ANCHOR_STEP = 1024.0
NEAR = 4 * ANCHOR_STEP
# Vertices along the side of a page of the arrays of diamonds.
PAGE = 32


class TileBox(NamedTuple):
    """First and last samples of a tile along x and y; a neighbour shares the last ones."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def shape(self) -> tuple[int, int]:
        """Return the rows and columns of the samples."""
        return self.y1 - self.y0 + 1, self.x1 - self.x0 + 1

    @property
    def area(self) -> tuple[slice, slice]:
        """Return the rows and columns in an array of all samples, the last ones included."""
        return slice(self.y0, self.y1 + 1), slice(self.x0, self.x1 + 1)


@dataclass(frozen=True)
class Lattice:
    """`columns` x `rows` root squares of `2**levels` cells a side over a raster of `cells_x` x `cells_y` cells.

    A cell is `step_x` by `step_y` metres. `cells_x` and `cells_y` default to all cells of the squares. The terrain's
    space has its origin, the anchor, `anchor_x` and `anchor_y` metres from the raster's middle.
    """

    columns: int
    rows: int
    levels: int
    step_x: float = 1.0
    step_y: float = 1.0
    cells_x: int = 0
    cells_y: int = 0
    anchor_x: float = 0.0
    anchor_y: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells_x", self.cells_x or self.columns << self.levels)
        object.__setattr__(self, "cells_y", self.cells_y or self.rows << self.levels)

    @property
    def width(self) -> int:
        """Return the raster's samples from west to east."""
        return self.cells_x + 1

    @property
    def height(self) -> int:
        """Return the raster's samples from south to north."""
        return self.cells_y + 1

    @property
    def span(self) -> tuple[int, int]:
        """Return the cells of the squares from west to east and from south to north, padding included."""
        return self.columns << self.levels, self.rows << self.levels

    @property
    def is_padded(self) -> bool:
        """Return whether the squares extend beyond the raster."""
        return self.span != (self.cells_x, self.cells_y)

    def rectangle(self) -> tuple[float, float, float, float]:
        """Return the west, south, east and north border of the raster, metres in the terrain's space."""
        x, y = 0.5 * self.cells_x * self.step_x, 0.5 * self.cells_y * self.step_y
        return -x - self.anchor_x, -y - self.anchor_y, x - self.anchor_x, y - self.anchor_y

    def anchor_near(self, x: float, y: float) -> tuple[float, float]:
        """Return an anchor near (x, y), metres from the raster's middle; (0, 0) if that is near enough.

        It is a multiple of ANCHOR_STEP inside the raster.
        """
        if max(abs(x), abs(y)) <= NEAR:
            return 0.0, 0.0
        return _multiple_near(x, 0.5 * self.cells_x * self.step_x), _multiple_near(y, 0.5 * self.cells_y * self.step_y)

    @property
    def squares(self) -> int:
        """Return the number of root squares."""
        return self.columns * self.rows

    @property
    def square_bits(self) -> int:
        """Return the levels of the binary tree above the root squares, so that they become leaves of one tree."""
        return (self.squares - 1).bit_length()

    @property
    def side_bits(self) -> int:
        """Return the bits that number the root squares of a row or a column, whichever has more."""
        return (max(self.columns, self.rows) - 1).bit_length()

    @property
    def unit_bits(self) -> int:
        """Return log2 of the number of the smallest possible lattice units along the side of a square."""
        return min(SIDE_BITS - self.side_bits, SQUARE_BITS)

    @property
    def cell_depth(self) -> int:
        """Return the depth, inside a square, of the diamonds whose longest edge is the diagonal of a raster cell."""
        return 2 * self.levels + 1

    @property
    def groups(self) -> int:
        """Return the groups of depths above the raster's cells: two cell sizes each, in the last one maybe only one."""
        return (self.levels + 1) // 2

    def group(self, depth: int) -> int:
        """Return the group of a depth (1 .. cell_depth); the raster's cells are one more, the last."""
        return self.groups if depth == self.cell_depth else (self.levels - 1 - (depth - 1) // 2) // 2

    def extent(self, depth: int) -> tuple[int, int]:
        """Return the columns and rows with entries at a depth (1 .. cell_depth).

        At an odd depth they are those of the cells whose centres have entries; an even depth has those of the next one.
        With padding, one column or row is beyond the border; the boxes of further ones are entirely beyond it.
        """
        side = self.levels - depth // 2  # log2 of the raster cells along the side of such a cell
        columns, rows = self.columns << depth // 2, self.rows << depth // 2
        return min(columns, -(-self.cells_x >> side) + 1), min(rows, -(-self.cells_y >> side) + 1)

    def layout(self) -> tuple[np.ndarray, np.ndarray]:
        """Return first entries, int64 [groups + 2], and pages a row, int32 [groups + 1], of the groups and the cells.

        The last of the first entries is the total. `kernels/field/layout.py` defines the order inside a group.
        """
        return _images(self, self.levels)

    def range_layout(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the layout of the ranges: of every other sample, since the two finest depths have none."""
        return _images(self, self.levels - 1)

    @property
    def is_addressable(self) -> bool:
        """Return whether coordinates of the lattice can number the samples of a row and of a column."""
        return self.side_bits + self.levels <= SIDE_BITS

    @property
    def cell_base(self) -> int:
        """Return the first entry of the raster's cells in an error hierarchy, after those of coarser diamonds."""
        return int(self.layout()[0][-2])

    @property
    def range_depth(self) -> int:
        """Return the deepest bisection with stored ranges, of sides of cells of 4 x 4 samples; 0 if there is none."""
        return max(2 * self.levels - 2, 0)

    @property
    def range_count(self) -> int:
        """Return the entries of the ranges without the raster's cells, which follow for a bicubic surface."""
        return int(self.range_layout()[0][-2])

    @property
    def node_count(self) -> int:
        """Return the number of entries of an error hierarchy."""
        return int(self.layout()[0][-1])


@lru_cache(maxsize=64)
def _images(lattice: Lattice, levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first entries and pages a row of the images in which groups of depths are stored, and of the cells.

    levels: as if a root square had 2**levels cells a side: one less for ranges, which have every other vertex. The
    first entries, int64, end with the total; pages, int32, have an item for each group and one for the cells. Both
    arrays are cached and read-only.
    """
    sizes, pages = [0], []  # entries of each image, after a 0; pages in a row of each
    for group in range((levels + 1) // 2 + 1):
        if group == (levels + 1) // 2:  # the cells: columns and rows of their image
            wide, high = lattice.extent(lattice.cell_depth)
        else:
            # The group's coarsest cells reach farthest beyond the border (`extent`). Their centres have depth 2q + 1.
            q = max(levels - 2 - 2 * group, 0)
            side = levels - q - 2 * group  # log2 of the group's vertices along a cell of that depth
            wide, high = ((n << side) + 1 for n in lattice.extent(2 * q + 1))
        pages.append(-(-wide // PAGE))
        sizes.append(pages[-1] * -(-high // PAGE) * PAGE * PAGE)
    entries, pages_a_row = np.cumsum(sizes, dtype=np.int64), np.array(pages, np.int32)
    for array in (entries, pages_a_row):
        array.setflags(write=False)
    return entries, pages_a_row


def tile_index(x: np.ndarray, y: np.ndarray, pages: np.ndarray | int) -> np.ndarray:
    """Return the entries of vertices in an image with `pages` a row, as in kernels/field/layout.py.

    A page has 8 x 8 blocks of 4 x 4 vertices.
    """
    page = (y >> 5) * np.int64(pages) + (x >> 5)
    # Bits from the highest: page, block's row (3), block's column (3), row (2) and column (2) within the block.
    return page << 10 | (y & 28) << 5 | (x & 28) << 2 | (y & 3) << 2 | (x & 3)


def rows_of(image: np.ndarray, pages: int) -> np.ndarray:
    """Return an image of pages, [n, ...], as rows of vertices, [rows, PAGE * pages, ...]. pages: pages in a row."""
    rest = image.shape[1:]  # a page has 8 x 8 blocks of 4 x 4 vertices
    image = image.reshape(-1, pages, 8, 8, 4, 4, *rest)
    return image.transpose(0, 2, 4, 1, 3, 5, *range(6, image.ndim)).reshape(-1, PAGE * pages, *rest)


def pages_of(rows: np.ndarray) -> np.ndarray:
    """Return rows of vertices, [height, width, ...], as an image of pages, [n, ...]."""
    (height, width), rest = rows.shape[:2], rows.shape[2:]
    high, wide = -(-height // PAGE), -(-width // PAGE)
    full = np.zeros((high * PAGE, wide * PAGE, *rest), rows.dtype)
    full[:height, :width] = rows
    # a page has 8 x 8 blocks of 4 x 4 vertices
    full = full.reshape(high, 8, 4, wide, 8, 4, *rest)
    return full.transpose(0, 3, 1, 4, 2, 5, *range(6, full.ndim)).reshape(-1, *rest)


def _multiple_near(value: float, limit: float) -> float:
    """Return the multiple of ANCHOR_STEP from -limit to limit that is nearest to a number."""
    largest = limit // ANCHOR_STEP * ANCHOR_STEP
    return min(max(round(value / ANCHOR_STEP) * ANCHOR_STEP, -largest), largest)


def fit(width: int, height: int, step_x: float = 1.0, step_y: float = 1.0) -> Lattice:
    """Return the lattice of a raster of `width` x `height` samples, each at least 2, `step_x`, `step_y` metres apart.

    Its squares are the smallest ones that cover the raster's shorter side, or those of 2^SQUARE_BITS cells a side.
    """
    cells_x, cells_y = width - 1, height - 1
    levels = min((min(cells_x, cells_y) - 1).bit_length(), SQUARE_BITS)
    return Lattice(-(-cells_x >> levels), -(-cells_y >> levels), levels, step_x, step_y, cells_x, cells_y)


def lattice_for(width: int, height: int, step_x: float = 1.0, step_y: float = 1.0, name: str = "The raster") -> Lattice:
    """Return the lattice of a raster, from `fit`. Raises TerrainError for one that is too large.

    step_x, step_y: metres between samples. name: the raster's name, in the error.
    """
    lattice = fit(width, height, step_x, step_y)
    if not lattice.is_addressable:
        raise TerrainError(
            f"{name} has {width} x {height} samples",
            expected=f"at most 2^{SIDE_BITS} in a row or a column",
            fix="cut it into tiles or reduce it first",
        )
    return lattice
