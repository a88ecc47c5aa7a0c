# SPDX-License-Identifier: GPL-3.0-or-later
"""Land of which some tiles are loaded: everywhere else it is the bilinear surface of a coarser store.

The grid divides each cell of the coarser store into 2^bits x 2^bits cells. Inside such a cell with the twist T, the
surface has the error T/4 at its centre, and a quarter of that after each two bisections (field/hierarchy.py). With the
coarser store's own errors above its cells this is a nested function on all diamonds. It bounds the errors of tiles that
are not near a loaded one, and is the lower limit of all others, so the errors of all tiles together are nested.

A level has the diamonds that are split at the centres, and at the middles of the sides, of cells with 2^(level + 1)
samples a side. Two levels are a group. An array of errors has an image of each group: one entry for each vertex, in
pages of PAGE x PAGE vertices. The image of the single cells follows.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..field.finer_heights import raster_heights
from ..field.heightfield import HeightField
from ..field.holes import holes_around
from ..field.lattice import PAGE, TileBox, pages_of, tile_index
from .measure_tile import LargeError
from .tile_grid import TileGrid, cell_entries

ROUNDING = 4  # float32 steps of the highest height: of four rounded samples around a cell


@dataclass(frozen=True, eq=False)
class CoarseLand:
    """A coarser store, and the tiles of a finer grid that are loaded.

    Attributes:
        field: the coarser store.
        digest: of its source and settings.
        bits: binary logarithm of the number of cells along one of its cells.
        loaded: numbers of the loaded tiles.
    """

    field: HeightField
    digest: str
    bits: int
    loaded: frozenset[int]

    @property
    def rounding(self) -> np.float32:
        """Return the largest error that the rounding of interpolated heights makes, metres."""
        highest = max(abs(self.field.min_height), abs(self.field.max_height))
        return np.float32(ROUNDING * np.spacing(np.float32(highest)))

    def is_near_loaded(self, grid: TileGrid, number: int, margin: int) -> bool:
        """Return whether tile `number`, with `margin` samples around it, has samples of a loaded one."""
        rings = -(-margin // grid.side) if margin else 0
        row, column = divmod(number, grid.columns)
        return any(
            abs(other // grid.columns - row) <= rings and abs(other % grid.columns - column) <= rings
            for other in self.loaded
        )

    def heights(self, box: TileBox) -> np.ndarray:
        """Return the interpolated heights of a box, its last samples included, float32 metres; NaN inside of holes."""
        x, y = np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)
        heights = raster_heights(self.field, self.bits, x, y).astype(np.float32)
        if self.field.valid is not None:
            # Samples of which all cells around them are cut out (`logical_and`), so that holes keep their outline.
            heights[holes_around(self.field.valid, self.bits, x, y, np.logical_and)] = np.nan
        return heights

    def errors(self, grid: TileGrid, box: TileBox) -> np.ndarray:
        """Return the coarser store's errors of a tile's diamonds: float32 metres in the layout of the tile.

        grid: tiles of the finer raster. box: first and last samples of the tile in it.
        """
        local = grid.local(box)
        base, pages = local.layout()
        errors = np.zeros(local.node_count, np.float32)
        for group in range(local.groups):
            image = errors[base[group] : base[group + 1]]
            # The vertices of two levels in rows, one at every 4^group-th sample; the image has them in pages. In this
            # grid the vertices of a level are multiples of `half`, 1 or 2, and cells have 2 * half a side.
            row_length = PAGE * int(pages[group])
            rows = np.zeros((len(image) // row_length, row_length), np.float32)
            for level in range(2 * group, min(2 * group + 2, local.levels)):
                half = 1 << level - 2 * group
                # row and column of the first centre, and of the first middle of sides of either direction
                for y0, x0 in ((half, half), (0, half), (half, 0)):
                    is_centre = y0 == x0
                    if is_centre and level == local.levels - 1 and not grid.holds_roots:
                        continue  # the centre of a cell as large as the tile: `large_errors`
                    # Columns and rows of cells: those with these centres, or the smaller ones, with `half` a side, on
                    # whose corners the middles of sides are. From them, where the vertices end in `rows`.
                    counts = local.extent(2 * (local.levels - level) - is_centre)
                    x_end, y_end = (2 * half * n if is_centre else half * n + 1 for n in counts)
                    target = rows[y0 : y_end : 2 * half, x0 : x_end : 2 * half]
                    x = box.x0 + ((x0 + 2 * half * np.arange(target.shape[1])) << 2 * group)
                    y = box.y0 + ((y0 + 2 * half * np.arange(target.shape[0])) << 2 * group)
                    target[:] = self._errors_at(x, y[:, None], level, is_centre)
            image[:] = pages_of(rows)
        wide, high = local.extent(local.cell_depth)
        x, y = box.x0 + np.arange(wide), box.y0 + np.arange(high)[:, None]
        # Cell (x, y) is in the coarser cell (x >> bits, y >> bits). The error of that one is a quarter in cells of half
        # its side, and so on.
        cells = pages_of(
            self._cell_errors(x >> self.bits, y >> self.bits) * np.float32(0.25**self.bits) + self.rounding
        )
        errors[base[-2] :] = cells
        return errors

    def large_errors(self, large: list[LargeError]) -> Iterator[LargeError]:
        """Yield the errors `large`, of diamonds as large as a tile or larger, with the coarser store's values."""
        for item in large:
            x, y = np.array([item.x]), np.array([item.y])
            is_centre = bool(item.x & item.y & 1 << item.level)  # both are odd multiples of half a cell's side
            yield item._replace(error=float(self._errors_at(x, y, item.level, is_centre)[0]))

    def _errors_at(self, x: np.ndarray, y: np.ndarray, level: int, is_centre: bool) -> np.ndarray:
        """Return the coarser store's errors of diamonds that are split at samples (x, y) of one level, float32 metres.

        is_centre: the vertices are centres of cells, otherwise middles of their sides. `rounding` is added for the
        interpolated heights, which are rounded to float32.
        """
        coarser_level = level - self.bits  # in the coarser store's samples; below 0 inside its cells
        if coarser_level >= 0:
            base, pages = self.field.lattice.layout()
            group = coarser_level // 2  # of two levels, which share a layout and a table of errors in metres by code
            shift = self.bits + 2 * group
            entries = base[group] + tile_index(x >> shift, y >> shift, pages[group])
            codes = self.field.error[entries]
            return self.field.table[group][codes] + self.rounding
        error = self._cell_errors(x >> self.bits, y >> self.bits)
        if not is_centre:  # on the border of two coarser cells the sample before is in the other, else in the same one
            error = np.maximum(error, self._cell_errors(x - 1 >> self.bits, y - 1 >> self.bits))
        # The whole error at the coarser cell's centre (level -1), a quarter at the middles of its sides (-1) and at the
        # centres of its quarters (-2), and so on.
        quarterings = -coarser_level - is_centre
        return error * np.float32(0.25**quarterings) + self.rounding

    def _cell_errors(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the errors of the coarser store's cells (x, y), or of the nearest ones, float32 metres.

        They are stored as codes, which the last of the store's tables, that of cells, translates.
        """
        lattice = self.field.lattice
        columns, rows = lattice.extent(lattice.cell_depth)
        entries = cell_entries(lattice, np.clip(x, 0, columns - 1), np.clip(y, 0, rows - 1))
        return self.field.table[lattice.groups][self.field.error[entries]]
