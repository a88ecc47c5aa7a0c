# SPDX-License-Identifier: GPL-3.0-or-later
"""The heights of finer tiles (field/finer_tiles.py) at the levels below 0, as attributes read them.

A tile has SIDE x SIDE finer cells, a raster cell 2^bits x 2^bits. Tiles whose surface is the raster's are left out.
The tiles' own heights are level -bits. The levels between that one and the raster's are those of a pyramid over
all finer heights, of which each tile has its part and one more sample on each side. They have a third as many samples
as the finest level, and are cached like the coarser levels of the raster.
"""

import math
from functools import partial

import numpy as np
import warp as wp

from ...kernels.effects import finer_jet, footprint
from ...kernels.effects.pyramid import Pyramid
from ..field import codes, derived_arrays
from ..field.finer_heights import raster_heights
from ..field.finer_tiles import PYRAMID, SIDE, STRIDE, FinerTiles, pyramid_sides
from ..field.heightfield import HeightRaster
from ..field.lattice import Lattice
from ..run import launch, stopping
from ..run.buffers import flat
from ..run.locks import cached

Box = tuple[float, float, float, float]  # west, south, east and north border, metres in the terrain's space


def min_level(raster: HeightRaster) -> int:
    """Return the finest level of a raster's heights: -bits with finer tiles, else 0."""
    return -raster.finer.bits if raster.finer else 0


def finer_places(raster: HeightRaster) -> footprint.FinerPlaces:
    """Return the tiles with finer heights, for kernels; cached with the raster, which has finer tiles."""
    assert raster.finer is not None
    return _where_finer(raster, raster.finer)[1]


def finer_heights(raster: HeightRaster, threads: int) -> wp.array:
    """Return the finer heights of a raster for kernels: an array of one struct, empty without finer tiles.

    Cached with the raster; the coarser levels of a large one are in its store.
    """
    if raster.finer is None:
        return wp.empty(0, dtype=finer_jet.FinerHeights, device=launch.DEVICE)
    _levels, packed = cached(raster.cache.results, (PYRAMID,), partial(_pack_heights, raster, raster.finer, threads))
    return packed


def is_finer(raster: HeightRaster, box: Box) -> bool:
    """Return whether heights are finer than the raster's anywhere in a box.

    box: its west, south, east and north, metres in the terrain's space.
    """
    if raster.finer is None:
        return False
    lattice, differs = raster.lattice, _where_finer(raster, raster.finer)[0]
    west, south, _, _ = lattice.rectangle()
    ranges = []
    for first, ends, step, count in (
        (south, box[1::2], lattice.step_y, len(differs)),
        (west, box[::2], lattice.step_x, differs.shape[1]),
    ):
        metres = step * (SIDE >> raster.finer.bits)  # of a tile
        # Numbers of tiles; -1 before the first, `count` after the last.
        low, high = (int(np.clip(math.floor((end - first) / metres), -1, count)) for end in ends)
        ranges.append(slice(max(low, 0), high + 1))
    return bool(differs[ranges[0], ranges[1]].any())


def _where_finer(raster: HeightRaster, tiles: FinerTiles) -> tuple[np.ndarray, footprint.FinerPlaces]:
    """Return which tiles have heights that differ from the raster's, bool [rows, columns], and the same for kernels.

    Both are cached with the raster.
    """

    def make() -> tuple[np.ndarray, footprint.FinerPlaces]:
        """Compute both."""
        differs = tiles.differing(raster.lattice)
        return differs, _pack_places(raster.lattice, tiles.bits, differs)

    return cached(raster.cache.results, ("finer places",), make)


def _pack_places(lattice: Lattice, bits: int, differs: np.ndarray) -> footprint.FinerPlaces:
    """Return which tiles have finer heights, for kernels. Those at the raster's border count as continued beyond it.

    lattice: the raster's. bits: a raster cell has 2^bits finer cells a side. differs: where tiles have finer heights,
    bool [rows, columns].
    """
    rows, columns = differs.shape
    padded = np.pad(differs, 1, mode="edge")
    missing_neighbours = np.zeros((rows, columns), np.int32)
    for row in range(3):
        for column in range(3):
            # bit 3 * row + column: that one of the 3 x 3 tiles around has no finer heights
            missing_neighbours |= ~padded[row : row + rows, column : column + columns] * np.int32(1 << 3 * row + column)
    places = footprint.FinerPlaces()
    places.bits, places.columns = bits, columns
    missing_neighbours[~differs] = -1  # a tile without finer heights
    places.missing_neighbours = flat(missing_neighbours, wp.int32)
    places.cells_x, places.cells_y = lattice.cells_x << bits, lattice.cells_y << bits
    places.west, places.south, _, _ = lattice.rectangle()
    # Finer cells a metre.
    places.per_x, places.per_y = (1 << bits) / lattice.step_x, (1 << bits) / lattice.step_y
    return places


def _pack_heights(raster: HeightRaster, tiles: FinerTiles, threads: int) -> tuple[np.ndarray, wp.array]:
    """Return the levels above the tiles' own heights, float32, and all levels for kernels, an array of one struct.

    The levels are in one flat array, the finest first, each with its samples of all tiles. tiles: finer heights;
    `tiles.numbers`, int32 [rows, columns], has the index of each tile in them, -1 for none.
    """
    lattice, sides = raster.lattice, pyramid_sides(tiles.bits)
    size, positions = tiles.pyramid_size(lattice), np.argwhere(_where_finer(raster, tiles)[0])
    shapes = {PYRAMID: ((size,), np.float32)}

    def fill(arrays: dict[str, np.ndarray]) -> None:
        """Compute the coarser levels of all tiles into `arrays`, those of a range of tiles on each thread."""
        levels = _split_levels(arrays[PYRAMID], sides, len(positions))
        ranges = launch.ranges(len(positions), max(1, min(threads, len(positions))))
        with launch.timed("prefilter"):
            launch.together([partial(_fill_levels, raster, tiles, positions, levels, slice(*ends)) for ends in ranges])

    # Levels of many samples are cached in the store, those of few only if the raster itself is large.
    has_many = size >= derived_arrays.MIN_CACHED
    derive = derived_arrays.derive_cached if has_many else derived_arrays.derive_cached_if_large
    coarser = derive(raster, shapes, fill)[PYRAMID]
    # Numbers of tiles in the coarser levels, which have only the tiles at `positions`; -1 for those left out.
    level_numbers = np.full(tiles.numbers.shape, -1, np.int32)
    level_numbers[tuple(positions.T)] = np.arange(len(positions))
    packed = finer_jet.FinerHeights()
    packed.bits, packed.columns = tiles.bits, tiles.numbers.shape[1]
    packed.tiles, packed.numbers = flat(tiles.numbers, wp.int32), flat(level_numbers, wp.int32)
    packed.cells_x, packed.cells_y = lattice.cells_x << tiles.bits, lattice.cells_y << tiles.bits
    packed.levels = _pack_levels(lattice, tiles, coarser, len(positions))
    array = wp.array([packed], dtype=finer_jet.FinerHeights, device=launch.DEVICE)
    array.parts = packed  # its arrays live as long
    return coarser, array


def _pack_levels(lattice: Lattice, tiles: FinerTiles, coarser: np.ndarray, count: int) -> Pyramid:
    """Return the levels of all tiles as a pyramid; only the fields that `jet_of` and `tile_jet` read are set.

    Level 0 is the tiles' own heights, STRIDE x STRIDE samples each: one more than a tile's on each side. lattice: the
    raster's. coarser: the levels above them, which `count` tiles have, float32, one after another. A level is as wide
    as one tile, and the tiles follow each other as its rows.
    """
    sides, levels = pyramid_sides(tiles.bits), Pyramid()
    levels.samples = codes.pack_samples(tiles.heights.reshape(-1, STRIDE), steps=None)
    levels.coarser = flat(coarser, wp.float32)
    sizes = [count * side * side for side in sides]
    # First sample of each level in `coarser`; the tiles' own heights, level 0, are not in it.
    first = np.cumsum([0, 0, *sizes])[: len(sides) + 1]
    levels.first = wp.array(first, dtype=wp.int64, device=launch.DEVICE)
    levels.columns = wp.array([STRIDE, *sides], dtype=wp.int32, device=launch.DEVICE)
    rows = [len(tiles.heights) * STRIDE, *(count * side for side in sides)]
    levels.rows = wp.array(rows, dtype=wp.int32, device=launch.DEVICE)
    # Finer cells a metre.
    levels.per_x, levels.per_y = (1 << tiles.bits) / lattice.step_x, (1 << tiles.bits) / lattice.step_y
    return levels


def _split_levels(values: np.ndarray, sides: list[int], count: int) -> list[np.ndarray]:
    """Return the levels of a flat array of `count` tiles, float32 [count, side, side] each.

    sides: samples along a side of a tile at each level, in the order of the array.
    """
    levels, first = [], 0
    for side in sides:
        levels.append(values[first : first + count * side * side].reshape(count, side, side))
        first += count * side * side
    return levels


def _fill_levels(
    raster: HeightRaster, tiles: FinerTiles, positions: np.ndarray, levels: list[np.ndarray], tile_range: slice
) -> None:
    """Fill the coarser levels of a range of tiles. positions: row and column of each tile, int64 [tiles, 2].

    levels: arrays of the levels, the finest first. tile_range: numbers of the tiles.
    """
    around = 1 << tiles.bits  # finer cells that the coarsest level reads beyond a tile
    # `last`, `first`, `low` and `high` are (y, x) in finer cells: the raster's last sample, the tile's first one, and
    # the first and the last one of the window around the tile.
    last = raster.lattice.cells_y << tiles.bits, raster.lattice.cells_x << tiles.bits
    for number in range(tile_range.start, tile_range.stop):
        stopping.check()
        first = SIDE * positions[number]
        low = np.maximum(first - around, 0)
        high = np.minimum(first + SIDE + around, last)
        heights = _window(raster, tiles, low, high)
        for level, out in enumerate(levels, start=1):
            heights = _halve(heights)
            # From the sample before the tile's first to the one after its last, extrapolated beyond the border. The
            # tile's first sample is (first - low) >> level in `heights`; indices of `extended` are larger by 1, so that
            # this is the sample before it.
            extended = np.pad(heights, 1, mode="reflect", reflect_type="odd")
            rows, columns = (
                np.clip(np.arange(len(out[number])) + (first[k] - low[k] >> level), 0, extended.shape[k] - 1)
                for k in (0, 1)
            )
            out[number] = extended[np.ix_(rows, columns)]


def _window(raster: HeightRaster, tiles: FinerTiles, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the heights of finer samples from row and column `low` to `high`, inclusive, float32 [rows, columns].

    Where none of the `tiles` has finer heights, they are interpolated from the raster.
    """
    heights = np.empty(high - low + 1, np.float32)
    for row in range(low[0] // SIDE, -(-high[0] // SIDE)):
        for column in range(low[1] // SIDE, -(-high[1] // SIDE)):
            # First and last samples of the tile that are in the window.
            y0, x0 = max(SIDE * row, low[0]), max(SIDE * column, low[1])
            y1, x1 = min(SIDE * (row + 1), high[0]), min(SIDE * (column + 1), high[1])
            number = tiles.numbers[row, column]
            if number >= 0:
                y, x = 1 + y0 - SIDE * row, 1 + x0 - SIDE * column  # a tile has a sample more on each side
                part = tiles.heights[number, y : y + y1 - y0 + 1, x : x + x1 - x0 + 1]
            else:
                part = raster_heights(raster, tiles.bits, np.arange(x0, x1 + 1), np.arange(y0, y1 + 1))
            heights[y0 - low[0] : y1 - low[0] + 1, x0 - low[1] : x1 - low[1] + 1] = part
    return heights


def _halve(heights: np.ndarray) -> np.ndarray:
    """Return the means around every other sample with the weights [1 2 1] x [1 2 1] / 16, float32 [rows, columns].

    heights: an odd number of rows and of columns, so that the first and the last one stay. Beyond the border heights go
    on straight: twice the last one minus the mirrored one. The kernel `halve_level` computes the raster's own levels in
    the same way.
    """
    sums = heights.astype(np.float64)
    for _ in range(2):  # halves the rows and exchanges rows and columns: after two turns both are halved
        first, last = 2.0 * sums[:1] - sums[1:2], 2.0 * sums[-1:] - sums[-2:-1]
        before, after = np.concatenate([first, sums[1:-1:2]]), np.concatenate([sums[1::2], last])
        sums = ((before + after) + 2.0 * sums[::2]).T
    return (sums * 0.0625).astype(np.float32)
