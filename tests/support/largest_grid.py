# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain with 2^30 finest cells a side, in memory that the system commits where it is touched."""

import mmap
from dataclasses import replace
from functools import cache

import numpy as np
from adaptive_terrain.cbt_terrain.field.blocks import level_shapes
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.finer_build import with_finer_tiles
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE, FinerTiles, tile_shape
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.field.lattice import TileBox, lattice_for

BITS, SMALL, KNOWN = 8, 16, 4  # cells of a raster cell, raster cells of the small raster, tiles that are not level
NO_RESERVE = 0x4000  # MAP_NORESERVE of Linux


def virtual_zeros(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Return an array of zeros, perhaps larger than the memory."""
    nbytes = int(np.prod(shape, dtype=object)) * np.dtype(dtype).itemsize
    memory = mmap.mmap(-1, nbytes, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | NO_RESERVE)
    return np.frombuffer(memory, dtype).reshape(shape)


def hill_heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return heights, metres, at finer samples of the small raster: hills in its north-eastern quarter, 0 elsewhere."""
    along_x, along_y = (np.clip((at - SIDE * (SMALL - KNOWN)) / 150.0 - 0.2, 0.0, 1.0) for at in (x, y))
    waves = 60.0 * np.sin(x / 71.0) * np.cos(y / 53.0) + 6.0 * np.sin(x / 9.0 + y / 13.0)
    return (along_x * along_y * (90.0 + waves + 0.3 * np.sin(x / 2.3 - y / 3.1))).astype(np.float32)


def corner_terrain(columns: int, rows: int) -> HeightField:
    """Return a level raster of `columns` x `rows` cells of 256 m, with hills of 1 m steps in its far corner.

    All squares have finer tiles: the level ones share tile 0.
    """
    small = _small_terrain()
    lattice = lattice_for(columns + 1, rows + 1, 256.0, 256.0)
    raster = replace(
        small.raster,
        samples=virtual_zeros((rows + 1, columns + 1), np.float32),
        lattice=lattice,
        finer=_in_corner(small.raster.finer, lattice),
        origin=np.array([5e5, 5e6, 0.0]),
        place=(1.0, 0.0, 5e5, 0.0, 1.0, 5e6),
    )
    error = virtual_zeros((lattice.node_count,), np.uint8)
    ranges = virtual_zeros((lattice.range_count, 2), np.uint16)
    exponents = (small.exponents[0],) * (lattice.groups + 1)
    return replace(small, raster=raster, error=error, ranges=ranges, exponents=exponents)


@cache
def _small_terrain() -> HeightField:
    """Return the small raster with the hills."""

    def read(box: TileBox) -> np.ndarray:
        return hill_heights(np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)[:, None])

    plain = from_array(np.zeros((SMALL + 1, SMALL + 1), np.float32), 256.0, 256.0)
    known = [(SMALL - 1 - i, SMALL - 1 - j) for j in range(KNOWN) for i in range(KNOWN)]
    return with_finer_tiles(plain, BITS, known, read)


def _in_corner(tiles: FinerTiles, lattice) -> FinerTiles:
    """Return tiles of the small raster in the far corner of a lattice, and level ones elsewhere."""
    shape, column, row = tile_shape(lattice, BITS), lattice.cells_x - SMALL, lattice.cells_y - SMALL
    numbers = virtual_zeros(shape, np.int32)
    numbers[row:, column:] = tiles.numbers + 1  # none is -1 there, so it becomes the level tile
    code = -tiles.range_base / tiles.range_step
    level = np.array([np.floor(code), np.ceil(code)], np.uint16)
    limits = virtual_zeros((sum(high * wide for high, wide in level_shapes(*shape)), 2), np.float32)
    first = 0
    finest = tiles.limits[: tiles.numbers.size].reshape(*tiles.numbers.shape, 2)
    for depth, (high, wide) in enumerate(level_shapes(*shape)):
        part = limits[first : first + high * wide].reshape(high, wide, 2)
        for j, i in np.argwhere(finest.any(axis=2)):
            place = part[(row + j) >> depth, (column + i) >> depth]
            np.maximum(place, finest[j, i], out=place)
        first += high * wide
    assert limits[-1].tolist() == tiles.limits[-1].tolist()
    return replace(
        tiles,
        numbers=numbers,
        heights=np.concatenate([np.zeros_like(tiles.heights[:1]), tiles.heights]),
        errors=np.concatenate([np.zeros_like(tiles.errors[:1]), tiles.errors]),
        ranges=np.concatenate([np.broadcast_to(level, tiles.ranges[:1].shape), tiles.ranges]),
        limits=limits,
    )
