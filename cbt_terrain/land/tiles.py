# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels and tiles of a raster: which samples a tile has, which it looks at, and how neighbours share a border.

Level 0 is the raster's own; sample i of level k is sample i * 2^k of the raster, or its last. Coarse levels are worked
on as a whole, of finer ones the tiles that are asked for: TILE x TILE cells each. A tile is made on a window that is
wider than itself, and counts by weights that fall from 1 to 0 across its borders and add up to 1 with its neighbours':
so a sample is the same from both sides, whoever came first, and beside a tile that nobody asked for the ground goes
over into that of the coarser level.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..ask.view import View
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..land_effects.levels import COARSEST
from ..maps import sizing
from ..maps.tiling import Tiling

TILE = 256
# Samples beyond a tile's border up to which it counts; a power of two, so that weights add up to exactly 1.
BAND = 16
# Samples along the longer side of the finest level that is worked on as a whole; and along the shorter one of a strip,
# where what slides has no room in which a tile could make up for it.
WHOLE, STRIP = 513, 128
# A level shows where a pixel is at most so many of its spacings wide.
PIXEL_SPACINGS = 2.0

Window = tuple[slice, slice]  # rows and columns of a level
# Of each level, by its number, the tiles that are asked for, with the metres by which heights may be off there; or
# None: the level as a whole.
Wanted = Sequence[Mapping[int, float] | None]


@dataclass(frozen=True)
class Level:
    """`number`: 0 for the raster's own samples. `rows`, `columns`: of samples, `step_x`, `step_y` metres apart."""

    number: int
    rows: int
    columns: int
    step_x: float
    step_y: float

    @property
    def shape(self) -> tuple[int, int]:
        return self.rows, self.columns

    @property
    def size(self) -> tuple[float, float]:
        """Metres from the first to the last row and column."""
        return (self.rows - 1) * self.step_y, (self.columns - 1) * self.step_x

    @property
    def whole(self) -> Window:
        """All its samples."""
        return slice(0, self.rows), slice(0, self.columns)

    @property
    def is_whole(self) -> bool:
        return max(self.shape) <= WHOLE or min(self.shape) <= STRIP

    @property
    def tiles(self) -> tuple[int, int]:
        """How many tiles there are northwards and eastwards; they are counted from the south-western one eastwards."""
        return -(-(self.rows - 1) // TILE), -(-(self.columns - 1) // TILE)

    @property
    def tile_count(self) -> int:
        return self.tiles[0] * self.tiles[1]

    def window(self, tile: int, rows: int = 0, columns: int = 0) -> Window:
        """The samples of a tile with both its borders, and so many more all round, as far as there are any."""
        south, west = (n * TILE for n in divmod(tile, self.tiles[1]))
        return (
            slice(max(south - rows, 0), min(south + TILE + 1 + rows, self.rows)),
            slice(max(west - columns, 0), min(west + TILE + 1 + columns, self.columns)),
        )

    def weights(self, tile: int) -> np.ndarray:
        """float32 [rows, columns]: how much a tile counts, over its window with a BAND all round."""
        window = self.window(tile, BAND, BAND)
        places = divmod(tile, self.tiles[1])
        across = [_weights(s, n, count) for s, n, count in zip(window, places, self.tiles, strict=True)]
        return across[0][:, None] * across[1]

    def tiles_in(self, window: Window) -> set[int]:
        """The tiles that count anywhere in a window."""
        found = []
        for part, count in zip(window, self.tiles, strict=True):
            first, last = (part.start - BAND) // TILE, (part.stop - 1 + BAND) // TILE
            found.append(range(max(first, 0), min(last, count - 1) + 1))
        return {j * self.tiles[1] + i for j in found[0] for i in found[1]}

    def parent(self, tile: int) -> int:
        """The number of the tile at the next coarser level that a tile lies in."""
        j, i = divmod(tile, self.tiles[1])
        coarse_columns = -(-(self.columns // 2) // TILE)
        return j // 2 * coarse_columns + i // 2


def _weights(part: slice, number: int, count: int) -> np.ndarray:
    at = np.arange(part.start, part.stop, dtype=np.float32)
    low, high = number * TILE, (number + 1) * TILE
    rising = np.clip((at - (low - BAND)) / (2 * BAND), 0.0, 1.0) if number > 0 else np.ones_like(at)
    falling = np.clip(((high + BAND) - at) / (2 * BAND), 0.0, 1.0) if number < count - 1 else np.ones_like(at)
    return rising * falling


def levels_of(lattice: Lattice) -> list[Level]:
    """All levels of a raster, the finest first."""
    levels = [Level(0, lattice.height, lattice.width, lattice.step_x, lattice.step_y)]
    while max(levels[-1].shape) > COARSEST:
        fine = levels[-1]
        shape = fine.rows // 2 + 1, fine.columns // 2 + 1
        levels.append(Level(fine.number + 1, *shape, 2 * fine.step_x, 2 * fine.step_y))
    return levels


def every_tile(level: Level) -> dict[int, float]:
    """Every tile of a level, without any error."""
    return dict.fromkeys(range(level.tile_count), 0.0)


def all_tiles(lattice: Lattice) -> list[dict[int, float]]:
    """Every tile of every level."""
    return [every_tile(level) for level in levels_of(lattice)]


def whole_land(lattice: Lattice, finest: int = 0) -> Wanted:
    """All of the land, down to a level."""
    return [None if level.number >= finest else {} for level in levels_of(lattice)]


def tiles_seen(
    field: HeightField,
    views: Sequence[View],
    placement: np.ndarray | None = None,
    pixel_error: float = 1.0,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
) -> list[dict[int, float]]:
    """The tiles of each level that views see as fine as that level, with the metres that so many pixels are there.

    A function of the views, the placement (4 x 4, of the terrain in the world) and the raster: reads every sample.
    Metres are rounded down to quarters of an octave, so that what is asked for stays while a camera creeps.
    """
    levels = levels_of(field.lattice)
    placement = np.eye(4) if placement is None else np.asarray(placement, np.float64)
    boxes, found = None, []
    for level in levels:
        boxes = _boxes(level, field, vertical_scale, vertical_offset) if boxes is None else _merged(level, boxes)
        pixels = sizing.footprints(boxes.reshape(-1, 2, 3), views, placement, only_seen=True)
        wide = PIXEL_SPACINGS * max(level.step_x, level.step_y)
        near = np.flatnonzero(pixels <= wide)
        metres = pixels[near] * pixel_error / max(abs(vertical_scale), 1e-30)
        found.append({int(tile): _rounded(m) for tile, m in zip(near, metres, strict=True)})
    return found


def _rounded(metres: float) -> float:
    return 2.0 ** (math.floor(math.log2(metres) * 4) / 4) if 0.0 < metres < math.inf else float(metres)


def _boxes(level: Level, field: HeightField, vertical_scale: float, vertical_offset: float) -> np.ndarray:
    """float64 [tiles north, tiles east, 2, 3]: what the ground of each tile of level 0 lies in."""
    west, south, _, _ = field.lattice.rectangle()
    sides = TILE * level.step_x, TILE * level.step_y
    tiling = Tiling(level.tiles[1], level.tiles[0], west, south, *sides, 0.0)
    return sizing.boxes(tiling, field, vertical_scale, vertical_offset).reshape(*level.tiles, 2, 3)


def _merged(level: Level, boxes: np.ndarray) -> np.ndarray:
    """The boxes of a level from those of the next finer one, four of which are one."""
    rows, columns = level.tiles
    padded = np.pad(boxes, [(0, 2 * rows - boxes.shape[0]), (0, 2 * columns - boxes.shape[1]), (0, 0), (0, 0)], "edge")
    four = padded.reshape(rows, 2, columns, 2, 2, 3)
    return np.stack([four[..., 0, :].min(axis=(1, 3)), four[..., 1, :].max(axis=(1, 3))], axis=2)


@dataclass(frozen=True)
class Needed:
    """What a tile calls for. `metres`: by which heights may be off in it. `tiles`: of its level, itself and those that
    finer ones in it start from, which are made whenever it is: so what a tile is does not depend on any metres."""

    metres: float
    tiles: frozenset[int]


def closed(
    levels: Sequence[Level], wanted: Sequence[Mapping[int, float]], halo: Sequence[tuple[int, int]]
) -> list[dict[int, Needed]]:
    """What is wanted, and the tiles of coarser levels that it lies in, each with all that are made with it.

    halo: rows and columns that the effects look beyond a tile, by level.
    """
    found = [{tile: Needed(metres, frozenset({tile})) for tile, metres in tiles.items()} for tiles in wanted]
    for fine, coarse in zip(levels, levels[1:], strict=False):
        rows, columns = (BAND + h for h in halo[fine.number])
        needed, below = found[coarse.number], {}
        for tile in set().union(*(need.tiles for need in found[fine.number].values())):
            window = fine.window(tile, rows, columns)
            below[tile] = coarse.tiles_in(tuple(slice(part.start // 2, (part.stop - 1) // 2 + 2) for part in window))
        for tile, need in found[fine.number].items():
            parent = fine.parent(tile)
            known = needed.get(parent, Needed(math.inf, frozenset({parent})))
            tiles = known.tiles.union(*(below[tile] for tile in need.tiles))
            needed[parent] = Needed(min(need.metres, known.metres), tiles)
    return found
