# SPDX-License-Identifier: GPL-3.0-or-later
"""Levels and tiles of a raster: their samples, their windows, and the weights that blend tiles at their borders.

Level 0 is the raster itself; sample i of level k is sample i * 2^k of the raster, or its last. Coarse levels are
computed as a whole, finer ones in the requested tiles of TILE x TILE cells. A tile is computed on a wider window and
weighted: weights fall from 1 to 0 across its borders and add up to 1 with those of its neighbours. The result therefore
does not depend on the order of tiles, and next to a tile that is not requested it blends into the coarser level.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..attributes.tiling import Tiling
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..view.view import View
from .levels import COARSEST

TILE = 256
# Samples beyond a tile's border where its weight is not 0; a power of two, so that weights add up to exactly 1.
BAND = 16
# Samples along the longer side of the finest level that is computed as a whole; and along the shorter side of a strip,
# which is computed as a whole too, since a tile of it could not balance material that slides out of its window.
WHOLE, STRIP = 513, 128
# A level is visible where a pixel is at most this many of its spacings wide.
PIXEL_SPACINGS = 2.0

Window = tuple[slice, slice]  # rows and columns of a level
# For each level, by its number, the requested tiles with their allowed errors in metres; None: the level as a whole.
Wanted = Sequence[Mapping[int, float] | None]


@dataclass(frozen=True)
class Level:
    """A grid of samples, `step_x` and `step_y` metres apart; number 0 is the raster itself."""

    number: int
    rows: int
    columns: int
    step_x: float
    step_y: float

    @property
    def shape(self) -> tuple[int, int]:
        """Return the number of rows and columns of samples."""
        return self.rows, self.columns

    @property
    def size(self) -> tuple[float, float]:
        """Return the metres from the first to the last row, and from the first to the last column."""
        return (self.rows - 1) * self.step_y, (self.columns - 1) * self.step_x

    @property
    def whole(self) -> Window:
        """Return the window of all samples."""
        return slice(0, self.rows), slice(0, self.columns)

    @property
    def is_whole(self) -> bool:
        """Return whether the level is always computed in one piece, since it is small or narrow."""
        return max(self.shape) <= WHOLE or min(self.shape) <= STRIP

    @property
    def tiles(self) -> tuple[int, int]:
        """Return the number of tiles from south to north and from west to east.

        Tiles are numbered row by row from the south-western one.
        """
        return -(-(self.rows - 1) // TILE), -(-(self.columns - 1) // TILE)

    @property
    def tile_count(self) -> int:
        """Return the number of tiles."""
        return self.tiles[0] * self.tiles[1]

    def window(self, tile: int, rows: int = 0, columns: int = 0) -> Window:
        """Return the window of a tile with both its borders, widened by `rows` and `columns` within the level."""
        south, west = (n * TILE for n in divmod(tile, self.tiles[1]))
        return (
            slice(max(south - rows, 0), min(south + TILE + 1 + rows, self.rows)),
            slice(max(west - columns, 0), min(west + TILE + 1 + columns, self.columns)),
        )

    def weights(self, tile: int) -> np.ndarray:
        """Return the weights with which a tile is blended with its neighbours, float32 [rows, columns].

        They are for the tile's window widened by BAND, and fall from 1 to 0 over 2 BAND samples.
        """
        window = self.window(tile, BAND, BAND)
        position = divmod(tile, self.tiles[1])
        north, east = (_weights(axis, n, count) for axis, n, count in zip(window, position, self.tiles, strict=True))
        return north[:, None] * east

    def tiles_in(self, window: Window) -> set[int]:
        """Return the tiles whose weight is not 0 somewhere in a window."""
        ranges = []
        for axis, count in zip(window, self.tiles, strict=True):
            first, last = (axis.start - BAND) // TILE, (axis.stop - 1 + BAND) // TILE
            ranges.append(range(max(first, 0), min(last, count - 1) + 1))
        return {j * self.tiles[1] + i for j in ranges[0] for i in ranges[1]}

    def parent(self, tile: int) -> int:
        """Return the number of the tile of the next coarser level that contains a tile."""
        j, i = divmod(tile, self.tiles[1])
        coarse_columns = -(-(self.columns // 2) // TILE)  # the coarser level has columns // 2 cells a row
        return j // 2 * coarse_columns + i // 2


def _weights(axis: slice, number: int, count: int) -> np.ndarray:
    """Return a tile's blending weights along one axis at the samples `axis`: a ramp up, ones and a ramp down, float32.

    There are no ramps at the level's ends. number: the tile's position along the axis, of `count` tiles.
    """
    positions = np.arange(axis.start, axis.stop, dtype=np.float32)
    low, high = number * TILE, (number + 1) * TILE
    up = np.clip((positions - (low - BAND)) / (2 * BAND), 0.0, 1.0) if number > 0 else np.ones_like(positions)
    down = (
        np.clip(((high + BAND) - positions) / (2 * BAND), 0.0, 1.0) if number < count - 1 else np.ones_like(positions)
    )
    return up * down


def levels_of(lattice: Lattice) -> list[Level]:
    """Return all levels of a raster, the finest first."""
    levels = [Level(0, lattice.height, lattice.width, lattice.step_x, lattice.step_y)]
    while max(levels[-1].shape) > COARSEST:
        fine = levels[-1]
        shape = fine.rows // 2 + 1, fine.columns // 2 + 1  # the last sample is at the border, or beyond it
        levels.append(Level(fine.number + 1, *shape, 2 * fine.step_x, 2 * fine.step_y))
    return levels


def every_tile(level: Level) -> dict[int, float]:
    """Return every tile of a level with an allowed error of 0 m."""
    return dict.fromkeys(range(level.tile_count), 0.0)


def all_tiles(lattice: Lattice) -> list[dict[int, float]]:
    """Return every tile of every level with an allowed error of 0 m."""
    return [every_tile(level) for level in levels_of(lattice)]


def whole_land(lattice: Lattice, finest: int = 0) -> Wanted:
    """Return a request for whole levels, from the coarsest down to number `finest`."""
    return [None if level.number >= finest else {} for level in levels_of(lattice)]


def tiles_seen(
    field: HeightField,
    views: Sequence[View],
    placement: np.ndarray | None = None,
    pixel_error: float = 1.0,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
) -> list[dict[int, float]]:
    """Return the visible tiles of each level in which the level can be seen, with allowed errors in metres.

    A level can be seen where a pixel is at most PIXEL_SPACINGS of its spacings wide. The error is `pixel_error` pixels
    at the tile, rounded down to a quarter of an octave, so that a slow camera does not change the request in every
    frame. views: the cameras. placement: 4 x 4 matrix of the terrain in the world, None for the identity. Heights are
    multiplied by `vertical_scale`, then `vertical_offset` metres are added.
    """
    from ..attributes import sizing

    levels = levels_of(field.lattice)
    placement = np.eye(4) if placement is None else np.asarray(placement, np.float64)
    boxes, tiles = None, []
    for level in levels:
        # Bounding boxes of the level's tiles, and the metres that a pixel covers there, infinite outside of all views.
        boxes = _boxes(level, field, vertical_scale, vertical_offset) if boxes is None else _merge_boxes(level, boxes)
        pixels = sizing.footprints(boxes.reshape(-1, 2, 3), views, placement, only_seen=True)
        fine_enough = np.flatnonzero(pixels <= PIXEL_SPACINGS * max(level.step_x, level.step_y))
        # Errors of heights before they are scaled.
        metres = pixels[fine_enough] * pixel_error / max(abs(vertical_scale), 1e-30)
        tiles.append({int(tile): _round_error(m) for tile, m in zip(fine_enough, metres, strict=True)})
    return tiles


def _round_error(metres: float) -> float:
    """Return an error in metres, rounded down to a quarter of an octave. So small moves of a view change no request."""
    return 2.0 ** (math.floor(math.log2(metres) * 4) / 4) if 0.0 < metres < math.inf else float(metres)


def _boxes(level: Level, field: HeightField, vertical_scale: float, vertical_offset: float) -> np.ndarray:
    """Return the bounding boxes of the ground of each tile of level 0, float64 [tiles north, tiles east, 2, 3] metres.

    level: level 0. Heights are multiplied by `vertical_scale`, then `vertical_offset` metres are added.
    """
    from ..attributes import sizing

    west, south, _, _ = field.lattice.rectangle()
    sides = TILE * level.step_x, TILE * level.step_y
    tiling = Tiling(level.tiles[1], level.tiles[0], west, south, *sides, margin=0.0)
    return sizing.boxes(tiling, field, vertical_scale, vertical_offset).reshape(*level.tiles, 2, 3)


def _merge_boxes(level: Level, boxes: np.ndarray) -> np.ndarray:
    """Return the bounding boxes of a level's tiles, each around up to four tiles of the next finer level.

    boxes: those of the finer level. Both are float64 [rows, columns, lowest and highest, x y z], metres.
    """
    rows, columns = level.tiles
    # Tiles at the border have fewer than four.
    padded = np.pad(boxes, [(0, 2 * rows - boxes.shape[0]), (0, 2 * columns - boxes.shape[1]), (0, 0), (0, 0)], "edge")
    four = padded.reshape(rows, 2, columns, 2, 2, 3)
    return np.stack([four[..., 0, :].min(axis=(1, 3)), four[..., 1, :].max(axis=(1, 3))], axis=2)


@dataclass(frozen=True)
class TileNeed:
    """The allowed error of a tile in `metres`, and the `tiles` of its level that are computed with it.

    These are the tile itself and those that its finer tiles start from. They do not depend on the error, so neither
    does the tile's result.
    """

    metres: float
    tiles: frozenset[int]


def add_coarser(
    levels: Sequence[Level], wanted: Sequence[Mapping[int, float]], halo: Sequence[tuple[int, int]]
) -> list[dict[int, TileNeed]]:
    """Return the requested tiles and the tiles of coarser levels that contain them, by level.

    A coarser tile gets the smallest allowed error of itself and its finer tiles. The tiles of its level that the
    windows of these finer tiles read are computed with it. wanted: allowed error of each requested tile, metres, by
    level. halo: rows and columns that the operators read beyond a tile, by level. A TileNeed has the allowed error of a
    tile in metres, and the tiles that are computed with it.
    """
    needs = [{tile: TileNeed(metres, frozenset({tile})) for tile, metres in tiles.items()} for tiles in wanted]
    for fine, coarse in zip(levels, levels[1:], strict=False):
        rows, columns = (BAND + h for h in halo[fine.number])
        needed, sources = needs[coarse.number], {}  # sources: coarse tiles that the window of each tile reads
        for tile in set().union(*(need.tiles for need in needs[fine.number].values())):
            window = fine.window(tile, rows, columns)
            # Coarse sample k is sample 2 k: from the one at or before the window's first to the one after its last.
            y, x = (slice(axis.start // 2, (axis.stop - 1) // 2 + 2) for axis in window)
            sources[tile] = coarse.tiles_in((y, x))
        for tile, need in needs[fine.number].items():
            parent = fine.parent(tile)
            earlier = needed.get(parent, TileNeed(math.inf, frozenset({parent})))
            tiles = earlier.tiles.union(*(sources[tile] for tile in need.tiles))
            needed[parent] = TileNeed(min(need.metres, earlier.metres), tiles)
    return needs
