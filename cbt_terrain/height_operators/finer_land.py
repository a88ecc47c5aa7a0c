# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer tiles of shaped land (field/finer_tiles.py): operators shape the raster, and finer heights move with it.

A finer height changes by as much as the raster's surface at its position, so its difference to that surface, from which
bounds are computed, stays. Where the surface keeps its bits, so do the finer heights.
"""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...kernels.field import finer as kernels
from ..errors import TerrainError
from ..field.build import Allocate
from ..field.digests import digest_of
from ..field.finer_build import with_finer_tiles
from ..field.finer_heights import (
    LIMITED,
    MEASURED,
    RANGED,
    Arrays,
    FinerRecords,
    Tile,
    raster_heights,
)
from ..field.finer_tiles import SIDE
from ..field.heightfield import HeightField
from ..field.lattice import TileBox
from .tile_cache import TileCache, compute_digest

METHOD = 1  # increased when the same heights have other errors or ranges
COST = 3.3  # time of a finer sample, as a multiple of that of measuring a raster's sample: 0.8 us beside 0.24


def with_shaped_tiles(
    shaped: HeightField,
    source: HeightField,
    threads: int,
    allocate: Allocate,
    on_progress: Callable[[float], None],
    cache: TileCache,
) -> HeightField:
    """Return a shaped field with the finer tiles of its source, moved by the change of the raster's surface.

    Args:
        shaped: bilinear, on the source's lattice, without finer tiles.
        source: before shaping; without finer tiles the result is `shaped`.
        allocate: allocate(name, shape, dtype) returns a zeroed array, or one that an earlier attempt has left.
        on_progress: gets the finished fraction.
        cache: keeps measured tiles, so that neither a killed run nor another stack that leaves a tile as it is
            measures it again.

    Raises TerrainError for heights that are not finite.
    """
    finer = source.raster.finer
    if finer is None:
        return shaped

    def read(box: TileBox) -> np.ndarray:
        """Return the finer heights of a tile after shaping. box: in finer samples, 2^bits to a side of a cell."""
        number = finer.numbers[box.y0 // SIDE, box.x0 // SIDE]  # index of this tile, SIDE samples wide, in the heights
        # A stored tile has one more sample before its first row and column.
        heights = finer.heights[number, 1 : box.y1 - box.y0 + 2, 1 : box.x1 - box.x0 + 2]
        x, y = np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)
        found = move_heights(heights, *(raster_heights(field, finer.bits, x, y) for field in (source, shaped)))
        if not np.isfinite(found).all():
            raise not_finite()
        return found

    known, records = finer.known, CachedRecords(cache)  # known: the tiles with finer heights
    return with_finer_tiles(shaped, finer.bits, known, read, threads, allocate, on_progress, records)


def raster_part(source: HeightField) -> float:
    """Return the fraction of the time of measuring errors that the raster takes: 1 without finer tiles."""
    raster = source.lattice.width * source.lattice.height
    tiles = len(source.raster.finer.heights) if source.raster.finer is not None else 0
    return raster / (raster + COST * SIDE * SIDE * tiles)


def not_finite() -> TerrainError:
    """Return the error for a stack whose heights are not finite."""
    return TerrainError("The stack's heights are not finite numbers", fix="switch its effects off one by one")


def move_heights(heights: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return finer heights, float32 metres, moved by the change of the raster's surface from `before` to `after`.

    A height on the surface, in float32, is on it afterwards, so that no rounding counts as a difference.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.where(heights == before.astype(np.float32), after, heights + (after - before)).astype(np.float32)
    return np.where(after == before, heights, moved)


class CachedRecords(FinerRecords):
    """Limits, errors and ranges of finer tiles in a cache of tiles, by what determines them.

    Heights are computed again, which takes a sixth of the time.
    """

    # Shape and type of the array of each kind of record.
    SHAPES = {
        LIMITED: ((2,), np.float32),
        MEASURED: ((int(kernels.ERRORS),), np.uint8),
        RANGED: ((int(kernels.RANGES), 2), np.uint16),
    }

    def __init__(self, cache: TileCache) -> None:
        self._cache = cache

    def find(self, kind: str, place: Tile, inputs: str) -> Iterator[tuple[dict[str, Any], Arrays | None]]:
        """Yield the record of a tile and a function that returns its array (None for limits), if the cache has them.

        kind: LIMITED, MEASURED (errors) or RANGED. inputs: digest of all that determines the result. place: unused, as
        equal inputs give equal results. A record has the limits, or as `sums` the checksum of the array.
        """
        if kind in self.SHAPES:
            found = self._cache.find(kind, _key(kind, inputs), *self.SHAPES[kind])
            if found is not None and kind == LIMITED:
                yield {"inputs": inputs, "limits": [float(value) for value in found]}, None
            elif found is not None:
                yield {"inputs": inputs, "sums": digest_of([found])}, lambda _name, _tile: found

    def note(self, kind: str, place: Tile, array: np.ndarray | None = None, **values: Any) -> None:
        """Write the limits, errors or ranges of a tile into the cache.

        kind: LIMITED, MEASURED (errors) or RANGED; others, as heights, have no array and are not cached. place: unused.
        values: `inputs`, the digest of all that determines them, and `limits` for LIMITED. array: of the other kinds.
        """
        if kind == LIMITED:
            array = np.array(values["limits"], np.float32)
        if array is not None:
            self._cache.keep(kind, _key(kind, values["inputs"]), array)


def _key(kind: str, inputs: str) -> str:
    """Return the name of a tile's file in the cache. inputs: digest of all that determines its content."""
    return compute_digest(METHOD, kind, inputs)
