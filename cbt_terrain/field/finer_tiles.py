# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer tiles: heights at a fraction of a raster's step where they are known, as a city at 1 m in a country at 32 m.

A tile has SIDE x SIDE finer cells. Inside the tiles the surface is bilinear between the finer heights, elsewhere it is
that of the raster. Around the tiles with known heights there is a ring of tiles with the raster's own surface, so that
every diamond that meets a known height has its vertex in a tile.

The *change*, the difference of the two surfaces, is a displacement of the raster's surface, and bounded like one: its
error is added to that of the raster. For diamonds of cells of 2^STORED_BITS finer cells and smaller it is the saturated
error of hierarchy.py, computed from the differences at the finer samples. It is 0 where there is no tile, because no
height changes there. Larger diamonds take twice the largest change in their box. Both are nested, and so is their sum
with the raster's errors.
"""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ...kernels.field import finer as kernels
from ..errors import TerrainError
from ..run.buffers import flat, shared
from . import codes
from .blocks import level_shapes
from .lattice import Lattice
from .store_arrays import map_array

BOUNDS = int(kernels.CELLS)  # codes of a tile
TILE_BITS, SIDE, STRIDE = int(kernels.TILE_BITS), int(kernels.SIDE), int(kernels.STRIDE)
MAX_BITS = TILE_BITS  # a raster cell is not larger than a tile
REACH = 3 << int(kernels.STORED_BITS) - 1  # finer cells from a diamond's vertex to its box's border, at most
TILE_BYTES = 4 * STRIDE * STRIDE + int(kernels.ERRORS) + 4 * int(kernels.RANGES)  # of a tile in a store
ARRAYS = "numbers", "heights", "errors", "ranges", "limits"  # in files of a store
NUMBERS = "bits", "exponent", "range_base", "range_step"  # in its JSON file
PYRAMID = "finer_pyramid"  # file of the store that caches the coarser levels (attributes/finer_pyramid.py)


@dataclass(frozen=True, eq=False)
class FinerTiles:
    """The finer tiles of a raster; kernels/field/finer.py says how they are stored.

    Attributes:
        bits: a raster cell has 2^bits finer cells a side.
        numbers: int32 [rows, columns], number of each tile, -1 where there is none.
        heights: float32 [tiles, STRIDE, STRIDE], metres.
        errors: uint8 [tiles, ERRORS], codes of the errors of the change.
        ranges: uint16 [tiles, RANGES, 2], codes of the lowest and highest heights of diamonds.
        range_base, range_step: metres of code 0, and of a step.
        exponent: of the table of the error codes (codes.py).
        limits: float32 [blocks, 2], largest change, metres, and its largest slope along an axis, of each place of
            `numbers`, of 2 x 2 places, and so on to all.
        digest: identifies the content; "" for those of a store.
        off: largest distance, metres, of the surface from the bilinear one between heights: 0 for a bilinear surface.
        bounds: uint8 [tiles, BOUNDS], codes of the errors of a bicubic surface itself (finer_bicubic.py); empty for a
            bilinear one.
    """

    bits: int
    numbers: np.ndarray
    heights: np.ndarray
    errors: np.ndarray
    ranges: np.ndarray
    range_base: float
    range_step: float
    exponent: int
    limits: np.ndarray
    digest: str = ""
    off: float = 0.0
    bounds: np.ndarray = field(default_factory=lambda: np.zeros((0, BOUNDS), np.uint8))

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Return the arrays in the order of ARRAYS."""
        return self.numbers, self.heights, self.errors, self.ranges, self.limits

    @property
    def entry(self) -> dict[str, Any]:
        """Return the entry of a store's JSON: NUMBERS and the number of tiles with heights."""
        numbers = {name: getattr(self, name) for name in NUMBERS}
        return {"tiles": len(self.heights)} | numbers

    @property
    def known(self) -> list[tuple[int, int]]:
        """Return columns and rows of the tiles with known heights (`known_tiles`)."""
        return known_tiles(self.numbers)

    @property
    def max_change(self) -> float:
        """Return the largest change of a height, metres."""
        return float(self.limits[-1, 0])

    @property
    def max_slope(self) -> float:
        """Return the largest slope of the change along an axis."""
        return float(self.limits[-1, 1])

    def differing(self, lattice: Lattice) -> np.ndarray:
        """Return whether the surface differs from the raster's in each tile with cells of the raster.

        bool [rows, columns] of the table of tiles, without those beyond the border.
        """
        rows, columns = self.numbers.shape
        differs = self.limits[: rows * columns, 0].reshape(rows, columns) > 0.0
        rows, columns = (-(-(cells << self.bits) // SIDE) for cells in (lattice.cells_y, lattice.cells_x))
        return differs[:rows, :columns]

    def pyramid_size(self, lattice: Lattice) -> int:
        """Return the number of samples, at least 1, of the coarser levels of the tiles where the surface differs."""
        sides = pyramid_sides(self.bits)
        return max(int(self.differing(lattice).sum()) * sum(int(side * side) for side in sides), 1)

    @cached_property
    def packed(self) -> wp.array:
        """Return the tiles as kernels read them, an array of one struct; memory is shared."""
        tiles = kernels.PackedTiles()
        tiles.bits = self.bits
        tiles.rows, tiles.columns = self.numbers.shape
        tiles.tiles = flat(self.numbers, wp.int32)
        tiles.heights = codes.pack_samples(self.heights.reshape(-1, STRIDE), steps=None)
        tiles.errors = flat(self.errors, wp.uint8)
        tiles.table = shared(codes.tables([self.exponent])[0], wp.float32)
        tiles.bounds, tiles.bounds_table = flat(self.bounds, wp.uint8), shared(bounds_table(self.exponent), wp.float32)
        tiles.ranges = flat(self.ranges, wp.uint16)
        tiles.range_base, tiles.range_step, tiles.off = self.range_base, self.range_step, self.off
        tiles.limits = shared(self.limits, wp.vec2f)
        tiles.top = (max(self.numbers.shape) - 1).bit_length()  # coarsest level of the limits: one place for all tiles
        packed = wp.array([tiles], dtype=kernels.PackedTiles, device="cpu")
        packed.parts = tiles  # its arrays live as long
        return packed


def bounds_table(exponent: int) -> np.ndarray:
    """Return the metres of the codes of `FinerTiles.bounds`, float32 [256]; the last one stands for no bound.

    exponent: the codes of the errors of the change reach 2^exponent metres. Bounds reach almost twice as far; a larger
    one counts as none.
    """
    table = codes.tables([exponent + 1])[0]
    table[-1] = np.inf
    return table


def array_shapes(lattice: Lattice, bits: int, tiles: int) -> dict[str, tuple[tuple[int, ...], type]]:
    """Return shape and type of each array of `tiles` finer tiles, by the name of its file without suffix.

    bits: a raster cell has 2^bits finer cells a side.
    """
    rows, columns = tile_shape(lattice, bits)
    blocks = sum(int(high * wide) for high, wide in level_shapes(rows, columns))
    return {
        "finer_numbers": ((rows, columns), np.int32),
        "finer_heights": ((tiles, STRIDE, STRIDE), np.float32),
        "finer_errors": ((tiles, int(kernels.ERRORS)), np.uint8),
        "finer_ranges": ((tiles, int(kernels.RANGES), 2), np.uint16),
        "finer_limits": ((blocks, 2), np.float32),
    }


def tile_shape(lattice: Lattice, bits: int) -> tuple[int, int]:
    """Return rows and columns of the table of tiles: also those beyond the border that diamonds inside reach into.

    bits: a raster cell has 2^bits finer cells a side.
    """
    rows, columns = (((cells << bits) + REACH >> TILE_BITS) + 1 for cells in (lattice.cells_y, lattice.cells_x))
    return rows, columns


def has_known(numbers: np.ndarray) -> np.ndarray:
    """Return which tiles of a table have known finer heights: bool of the shape of `numbers` (`FinerTiles.numbers`).

    The neighbours of such a tile, as far as the table reaches, are tiles of it too. The tiles with known heights and
    those around them are all tiles of the table.
    """
    rows, columns = numbers.shape
    is_tile = np.pad(numbers >= 0, 1, constant_values=True)
    neighbours = [is_tile[down : down + rows, across : across + columns] for down in range(3) for across in range(3)]
    return np.logical_and.reduce(neighbours)


def known_tiles(numbers: np.ndarray) -> list[tuple[int, int]]:
    """Return columns and rows of the tiles of a table that have known finer heights (`has_known`)."""
    return [(int(column), int(row)) for row, column in np.argwhere(has_known(numbers))]


def bicubic_shapes(lattice: Lattice, bits: int, tiles: int) -> dict[str, tuple[tuple[int, ...], type]]:
    """Return shape and type of each array of the tiles of a bicubic surface (finer_bicubic.py), by name.

    bits: a raster cell has 2^bits finer cells a side. tiles: their number. finer_values_c has numbers of the whole
    surface: exponent, base and step of codes, lowest and highest height, and `FinerTiles.off`.
    """
    shapes = array_shapes(lattice, bits, tiles)
    arrays = {f"{name}_c": shapes[name] for name in ("finer_heights", "finer_errors", "finer_ranges", "finer_limits")}
    return arrays | {"finer_bounds_c": ((tiles, BOUNDS), np.uint8), "finer_values_c": ((6,), np.float64)}


def pyramid_sides(bits: int) -> list[int]:
    """Return the samples along a side of a tile at its levels 1 .. bits - 1, each half as fine as the one before.

    Level 0 is the tile itself, level `bits` would be as coarse as the raster. One sample more at each end is included.
    bits: a raster cell has 2^bits finer cells a side.
    """
    return [(SIDE >> level) + 1 + 2 for level in range(1, bits)]  # cells, their last sample, and one at each end


def open_tiles(folder: Path, lattice: Lattice, entry: dict[str, Any]) -> FinerTiles:
    """Map the finer tiles in a store's folder of arrays. entry: `FinerTiles.entry`.

    Raises FileNotFoundError if an array is missing, and TerrainError if one is damaged.
    """
    shapes = array_shapes(lattice, entry["bits"], entry["tiles"])
    values: dict[str, Any] = {name: entry[name] for name in NUMBERS}
    values |= {name: map_array(folder / f"finer_{name}.npy", *shapes[f"finer_{name}"]) for name in ARRAYS}
    numbers = values["numbers"]
    if numbers.min() < -1 or numbers.max() >= entry["tiles"]:
        what = f"The store {folder.parent} is damaged (a finer tile has no heights)"
        raise TerrainError(what, fix="import it again")
    return FinerTiles(**values)
