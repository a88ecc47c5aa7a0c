# SPDX-License-Identifier: GPL-3.0-or-later
"""Height fields with finer tiles, and their surface by other code: bilinear interpolation of one dense grid."""

from functools import cache
from unittest import mock

import numpy as np
from adaptive_terrain.cbt_terrain.field import finer_build
from adaptive_terrain.cbt_terrain.field.build import build, from_array
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.field.lattice import TileBox
from adaptive_terrain.cbt_terrain.field.store import Draft
from fields import rough

KNOWN = (2, 3), (3, 3), (3, 2)


@cache
def finer_field(
    rows: int = 97, columns: int = 130, bits: int = 4, known=KNOWN, seed: int = 7, relief: float = 6.0, block: int = 5
) -> HeightField:
    """Return rough land 32 m apart, with more relief in some tiles of 2 m or another fraction. Tests share it."""
    plain = rough(rows, columns, seed, relief=80.0, step=32.0)
    return in_small_squares(plain, bits, known, relief_reader(plain, bits, seed, relief), block)


def relief_reader(plain: HeightField, bits: int, seed: int = 7, relief: float = 6.0):
    """Return the function that gives finer heights: waves on the raster's surface, and NaN at some samples."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.02, 0.3, (6, 2)), rng.uniform(0, 6, 6)
    coarse = dense_raster(plain, bits)

    def read(box: TileBox) -> np.ndarray:
        x, y = np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)[:, None]
        own = sum(np.sin(a * x + b * y + c) for (a, b), c in zip(*waves, strict=True)) * relief / 6
        found = coarse[box.y0 : box.y1 + 1, box.x0 : box.x1 + 1] + own
        found[(x % 97 < 3) & (y % 61 < 2)] = np.nan  # only the raster is known there
        return found.astype(np.float32)

    return read


def finer_store(path, rows: int, columns: int, bits: int, known, step: float = 32.0, hole=None):
    """Write a store of rough land with finer tiles; return its path. hole: rows and columns without data, cut out."""
    draft, land = Draft(path), rough(rows, columns, 7, relief=80.0, step=step)
    samples = draft.allocate("samples", (rows, columns), np.float32)
    samples[:] = land.heights()
    if hole is not None:
        samples[hole] = np.nan
    missing = int(np.isnan(samples).sum())
    plain = build(samples, step, step, missing=missing, holes=hole is not None, allocate=draft.allocate)
    with mock.patch.object(finer_build, "BLOCK", 5):
        field = finer_build.with_finer_tiles(plain, bits, known, relief_reader(plain, bits), allocate=draft.allocate)
    draft.publish(field, "made by a test", {"warnings": []})
    return path


def in_small_squares(plain: HeightField, bits: int, known, read, block: int = 5) -> HeightField:
    """Add finer tiles, measured in squares of `block` tiles a side: the bytes are those of 8, the time is half."""
    with mock.patch.object(finer_build, "BLOCK", block):
        return finer_build.with_finer_tiles(plain, bits, known, read)


def dense_raster(field: HeightField, bits: int) -> np.ndarray:
    """Return the bilinear surface of a raster at all finer samples, float64, without the code of the product."""
    heights = field.heights().astype(np.float64)
    for axis in (0, 1):
        cells = heights.shape[axis] - 1
        at = np.arange((cells << bits) + 1) / (1 << bits)
        low = np.minimum(at.astype(int), cells - 1)
        part = (at - low).reshape((-1, 1) if axis == 0 else (1, -1))
        heights = np.take(heights, low, axis) * (1 - part) + np.take(heights, low + 1, axis) * part
    return heights


def dense_heights(field: HeightField) -> np.ndarray:
    """Return the heights of all finer samples of a field with finer tiles, float64."""
    tiles = field.raster.finer
    found = dense_raster(field, tiles.bits)
    for row, column in np.argwhere(tiles.numbers >= 0):
        part = found[SIDE * row : SIDE * row + SIDE + 1, SIDE * column : SIDE * column + SIDE + 1]
        part[:] = tiles.heights[tiles.numbers[row, column], 1:-1, 1:-1][: part.shape[0], : part.shape[1]]
    return found


@cache
def dense_field(field: HeightField) -> HeightField:
    """Return a field of all finer samples: the same surface without tiles."""
    step = 1 << field.raster.finer.bits
    heights = dense_heights(field).astype(np.float32)
    return from_array(heights, field.lattice.step_x / step, field.lattice.step_y / step)
